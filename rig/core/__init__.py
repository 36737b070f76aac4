"""The words everyone speaks: errors, quantities, the columns of a sample, the model of a rig."""
