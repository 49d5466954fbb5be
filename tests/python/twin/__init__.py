"""The core once more in plain NumPy and SciPy, close to the equations: tests compare with it.

What users compare with is in `stochens_rs.reference`.
"""
