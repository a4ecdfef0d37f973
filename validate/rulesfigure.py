"""The former place of `draw_rules`, which is `flysid.draw_rules`."""

import warnings

from flysid.validate.show.rulesfigure import draw_rules as draw_rules

warnings.warn("flysid.validate.rulesfigure.draw_rules is flysid.draw_rules", FutureWarning, stacklevel=2)
