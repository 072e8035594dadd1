"""The largest whole number below a formula, in SymPy."""

from __future__ import annotations

import sympy as sp

from statechart.kernels.whole import whole


class Whole(sp.Function):
    """The floor of a formula; SymPy's own is that of a number as it was rounded."""

    is_extended_real = True

    @classmethod
    def eval(cls, of: sp.Expr) -> sp.Expr | None:
        """Return that of a number; of anything else nothing is known yet."""
        return sp.Integer(whole(float(of))) if of.is_number and of.is_finite else None
