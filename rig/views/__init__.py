"""Draw pictures and write pages of results; a failure here must not affect a run or its recording."""
