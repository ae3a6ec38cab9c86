"""Tensor types that carry their axes, e.g. ``Float[Tensor, "chase sample tracker"]``.

The axes are checked while the tests run (jaxtyping and beartype). Where jaxtyping is not installed the
annotations mean plain tensors, so that training runs with torch, numpy and scipy alone.
"""

from typing import TYPE_CHECKING, Any

from torch import Tensor

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
else:
    try:
        from jaxtyping import Bool, Float, Int
    except ModuleNotFoundError:

        class _AnyAxes:
            def __class_getitem__(cls, item: Any) -> type[Tensor]:
                return Tensor

        Bool = Float = Int = _AnyAxes

__all__ = ["Bool", "Float", "Int", "Tensor"]
