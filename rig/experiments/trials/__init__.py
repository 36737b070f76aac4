"""One trial: its plan and checks, its run on a device, why it ended, its verdict, its recording and its replay."""
