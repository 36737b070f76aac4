"""Plan a study from its protocol: searches, conditions, order, durations, and expected numbers of trials."""
