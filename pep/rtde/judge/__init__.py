"""The judge of a leased program: its commands as requests, and permitted ones carried out."""
