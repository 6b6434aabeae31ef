"""Numbers of any kind, with NumPy: arrays and tables of files, intervals, and both as HTML."""
