"""The natural logarithm that gives the same bits on every processor, after FreeBSD's msun (``e_log.c``)."""

from __future__ import annotations

import math

from submaps._jit import jit

_LN2_HI = 6.93147180369123816490e-01
_LN2_LO = 1.90821492927058770002e-10
_ROOT_HALF = math.sqrt(0.5)


@jit("float64(float64)")
def log(x: float) -> float:
    """ln x of a finite x > 0, good to an ulp; see ``geometry.trig`` for why it is not a C library's."""
    fraction, exponent = math.frexp(x)
    if fraction < _ROOT_HALF:
        fraction *= 2.0
        exponent -= 1
    f = fraction - 1.0
    s = f / (2.0 + f)
    z = s * s
    w = z * z
    odd = w * (3.999999999940941908e-01 + w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01))
    even = z * (
        6.666666666666735130e-01
        + w * (2.857142874366239149e-01 + w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01))
    )
    half = 0.5 * f * f
    return s * (half + (odd + even)) + exponent * _LN2_LO - half + f + exponent * _LN2_HI
