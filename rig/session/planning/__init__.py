"""Plan a study from its protocol: sections and their rules, conditions, order, times, expected searches."""
