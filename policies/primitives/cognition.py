"""Domain CII, cognition and instruction integrity: what an agent is told, remembers and sees. None is written yet."""
