"""Time of a decision, ours and that of general policy engines on an equivalent rule set, in one run.

`facts` holds the facts of a case; `rules` holds those of our shipped set, compiled into plain conditions over facts;
each engine's module writes these conditions in its own language. Their answers are compared before anything is timed.
"""
