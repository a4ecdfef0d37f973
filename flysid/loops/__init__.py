"""What a log's present gains mean: the loop of a measured channel, its margins, what other gains would do."""
