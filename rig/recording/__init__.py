"""Recordings of trials as files, and the times at which the samples and commands of a trial occurred.

`recorder` writes a trial as a capture: a ``.rigcap`` file of raw blocks, whose rows survive a crash of the process
(`_capture` documents every byte). `seal` converts a capture to Parquet, `reader.open_recording` reads both formats, and
`export` writes a recording for other programs. All of these modules use one type, `data.Recording`: a header with
everything known before the trial, one row per control tick, and a trailer that states how the trial ended.
"""
