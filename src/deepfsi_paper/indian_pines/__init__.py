"""Indian Pines: spectra classified from few photons."""
