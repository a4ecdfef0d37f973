"""Why a model is right or wrong, and what to beware of before it is relied on."""
