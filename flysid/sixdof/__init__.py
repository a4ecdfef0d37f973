"""The whole vehicle: one model of a multirotor with six degrees of freedom, fitted to ordinary flights."""
