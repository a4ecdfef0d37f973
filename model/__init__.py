"""Dataset to model. One file per structure; see `base` for the protocol and its laws."""
