"""Robot shell: input of RTDE clients, its treatment, and the controller behind."""
