"""The report of a diagnosis.

Here: its sections, one a file; `page` has their order, `verdict_sentence` the sentence of the verdict.
Not here: what all reports share (ocp.report).
"""
