"""The paper's experiment: what it prints, and the same run again."""
