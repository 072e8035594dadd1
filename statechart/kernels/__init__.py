"""The compiled half of tapes and enclosures: one set of numba kernels for every model.

A tape (`statechart.tape`) is data, so these kernels are compiled once, whatever the model.
"""
