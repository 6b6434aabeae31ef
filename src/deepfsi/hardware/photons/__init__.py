"""PicoQuant PTU files: photon timestamps read, counted and written."""
