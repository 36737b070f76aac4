"""Recordings of trials on disk, and the times of their events.

A trial is captured by `recorder` as raw blocks that survive the death of the process (`capture` documents
every byte), sealed afterwards to Parquet by `seal`, read by `reader.open_recording` and handed to other tools
by `export`. All of them use one type, `data.Recording`: a header with everything known before the
trial, one row per tick, and a trailer with the end of the trial.
"""
