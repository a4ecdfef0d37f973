"""Which model errs less: scores, intervals and verdicts of a comparison, and conditions on them."""
