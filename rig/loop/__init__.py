"""The compiled control loop, for a law on the host or on the device, and the threads that run it.

Trials and motions run it. It must not open, configure or arm a device.
"""
