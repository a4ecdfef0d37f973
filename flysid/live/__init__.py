"""Links while they are alive: recording them without loss, and watching a vehicle against its model.

`links` opens them, `framing` finds frames, `ledger` counts per vehicle, `writing` puts records on the disk;
`receiving` joins the first three, `recording` all of them. `signing` refuses what is not signed.
"""

from flysid.live.links import open_link
from flysid.live.recording import Recording

__all__ = ["Recording", "open_link"]
