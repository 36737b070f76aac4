"""Recordings of trials on disk, and the times of their events.

`recorder` writes a trial as raw blocks that survive the death of the process (`_capture` documents every byte). `seal`
converts this capture to Parquet, `reader.open_recording` reads it, and `export` writes it for other programs. All of
them use one type, `data.Recording`: a header with everything known before the trial, one row per tick, and a trailer
that states how the trial ended.
"""
