"""Plan, check, run, judge, recover and replay one trial."""
