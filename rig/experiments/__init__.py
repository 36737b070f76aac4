"""What a lab does with a rig, each as a function with plain arguments and a typed result."""
