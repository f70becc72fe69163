"""Codes that commands and processes answer: cause, next step, exit status; and parts that cannot be had."""
