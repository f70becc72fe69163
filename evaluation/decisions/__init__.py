"""How long a decision takes, ours and that of general policy engines on an equivalent rule set, in one run.

`facts` are what is known of a case; `rules` are those of our shipped set, compiled into plain conditions over facts;
each engine's module writes these conditions in its own language. What they answer is compared before anything is timed.
"""
