"""Tensors that carry along what small pushes on earlier results would do to them.

Forward differentiation by a handful of numbers, of code that is written for plain tensors: given a
`Pushed` one it goes on as ever, and the derivatives come out with the result. Pushes may be made
one after another, and what was computed before a push pays nothing for it. There are only plain
operations beneath, so that all of it can be traced into one program.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Pushed:
    """A tensor and what it changes by for each unit of J pushes.

    Of two with different numbers of pushes, those of the one with fewer are the other's first.
    """

    value: Tensor  # [B, ...]
    by: Tensor  # [J, B, ...]

    @classmethod
    def __torch_function__(
        cls,
        func: Callable[..., Any],
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        rule = RULES.get(func.__name__.strip("_"))
        if rule is None:
            raise NotImplementedError(f"torch.{func.__name__} has no rule for pushed tensors")
        return rule(*args, **(kwargs or {}))

    def __getattr__(self, name: str) -> Callable[..., Any]:
        rule = RULES.get(name)
        if rule is None:
            raise AttributeError(f"{name} has no rule for pushed tensors")
        return lambda *args, **kwargs: rule(self, *args, **kwargs)

    def __getitem__(self, key: Any) -> Pushed:
        keys: tuple[Any, ...] = key if isinstance(key, tuple) else (key,)
        if keys[0] is not Ellipsis:
            return Pushed(self.value[keys], self.by[(slice(None), *keys)])
        return Pushed(self.value[keys], self.by[keys])

    def __gt__(self, other: float) -> Tensor:
        return self.value > other

    def __add__(self, other: Any) -> Pushed:
        return _add(self, other)

    def __sub__(self, other: Any) -> Pushed:
        return _subtract(self, other)

    def __mul__(self, other: Any) -> Pushed:
        return _multiply(self, other)

    def __rmul__(self, other: Any) -> Pushed:
        return _multiply(other, self)

    def __truediv__(self, other: Any) -> Pushed:
        return _divide(self, other)


def push(x: Tensor | Pushed) -> Pushed:
    """`x` [B, O], with a push on each of its O numbers beside those it carries already."""
    value = _value(x)
    own = torch.eye(value.shape[-1], dtype=value.dtype)[:, None].expand(-1, *value.shape)
    return Pushed(value, torch.cat((x.by, own)) if isinstance(x, Pushed) else own)


def _value(x: Any) -> Any:
    return x.value if isinstance(x, Pushed) else x


def _sum(*parts: Tensor) -> Tensor:
    """Changes [J, ...] by pushes, J of each its own, added up."""
    few, many = sorted(parts, key=len)
    if len(few) == len(many):
        return few + many
    shape = torch.broadcast_shapes(few.shape[1:], many.shape[1:])
    both = few + many[: len(few)]
    return torch.cat((both, many[len(few) :].expand(-1, *shape)))


def _add(x: Any, y: Any) -> Pushed:
    value = _value(x) + _value(y)
    if isinstance(x, Pushed) and isinstance(y, Pushed):
        return Pushed(value, _sum(x.by, y.by))
    by = x.by if isinstance(x, Pushed) else y.by
    return Pushed(value, by.expand(-1, *value.shape))


def _subtract(x: Any, y: Any) -> Pushed:
    return _add(x, Pushed(-y.value, -y.by) if isinstance(y, Pushed) else -y)


def _multiply(x: Any, y: Any) -> Pushed:
    value = _value(x) * _value(y)
    if isinstance(x, Pushed) and isinstance(y, Pushed):
        return Pushed(value, _sum(x.by * y.value, y.by * x.value))
    return Pushed(value, x.by * y if isinstance(x, Pushed) else x * y.by)


def _divide(x: Pushed, y: Tensor | float) -> Pushed:
    return Pushed(x.value / y, x.by / y)


def _linear(x: Pushed, weight: Tensor, bias: Tensor | None = None) -> Pushed:
    linear = torch.nn.functional.linear
    return Pushed(linear(x.value, weight, bias), linear(x.by, weight))


def _clamp(x: Pushed, min: float | None = None, max: float | None = None) -> Pushed:
    value = x.value.clamp(min, max)
    return Pushed(value, x.by * (value == x.value))


def _minimum(x: Pushed, y: Tensor) -> Pushed:
    return Pushed(torch.minimum(x.value, y), x.by * (x.value < y))


def _where(condition: Tensor, x: Any, y: Any) -> Pushed:
    like = x if isinstance(x, Pushed) else y
    zero = like.by.new_zeros(())
    x_by, y_by = (of.by if isinstance(of, Pushed) else zero for of in (x, y))
    return Pushed(torch.where(condition, _value(x), _value(y)), torch.where(condition, x_by, y_by))


def _softmax(x: Pushed, dim: int) -> Pushed:
    share = x.value.softmax(dim)
    dim = dim if dim < 0 else dim + 1
    return Pushed(share, share * (x.by - (share * x.by).sum(dim, keepdim=True)))


def _sinc(x: Pushed) -> Pushed:
    value, turn = x.value.sinc(), torch.pi * x.value
    still = x.value == 0.0
    slope = torch.where(still, 0.0, (turn.cos() - value) / torch.where(still, 1.0, x.value))
    return Pushed(value, slope * x.by)


def _joined(join: Callable[..., Tensor]) -> Callable[..., Pushed]:
    """Of `cat` or `stack`, some of whose parts may be plain."""

    def rule(parts: Sequence[Any], dim: int) -> Pushed:
        pushes = max(len(part.by) for part in parts if isinstance(part, Pushed))

        def whole(part: Any) -> Tensor:
            if not isinstance(part, Pushed):
                return part.new_zeros(()).expand(pushes, *part.shape)
            missing = pushes - len(part.by)
            if not missing:
                return part.by
            return torch.cat((part.by, part.by.new_zeros(()).expand(missing, *part.value.shape)))

        return Pushed(
            join([_value(part) for part in parts], dim),
            join([whole(part) for part in parts], dim if dim < 0 else dim + 1),
        )

    return rule


def _slope(of: Callable[[Tensor], tuple[Tensor, Tensor]]) -> Callable[..., Pushed]:
    """Of a function of each number: `of` gives its value and its slope."""

    def rule(x: Pushed) -> Pushed:
        value, slope = of(x.value)
        return Pushed(value, slope * x.by)

    return rule


def _tanh(x: Tensor) -> tuple[Tensor, Tensor]:
    value = x.tanh()
    return value, 1.0 - value * value


def _sigmoid(x: Tensor) -> tuple[Tensor, Tensor]:
    value = x.sigmoid()
    return value, value * (1.0 - value)


def _sqrt(x: Tensor) -> tuple[Tensor, Tensor]:
    value = x.sqrt()
    return value, 0.5 / value


def _split(x: Pushed, chunks: int) -> tuple[Pushed, ...]:
    """Along the last axis."""
    return tuple(map(Pushed, x.value.chunk(chunks, -1), x.by.chunk(chunks, -1)))


def _along(x: Pushed, name: str, dim: int, **how: Any) -> Pushed:
    """What moves or adds up numbers along an axis does the same to their changes."""
    there = dim if dim < 0 else dim + 1
    return Pushed(getattr(x.value, name)(dim, **how), getattr(x.by, name)(there, **how))


def _expand_as(x: Pushed, other: Tensor) -> Pushed:
    return Pushed(x.value.expand_as(other), x.by.expand(-1, *other.shape))


RULES: Final[Mapping[str, Callable[..., Any]]] = {
    "add": _add,
    "sub": _subtract,
    "mul": _multiply,
    "linear": _linear,
    "clamp": _clamp,
    "minimum": _minimum,
    "where": _where,
    "softmax": _softmax,
    "sinc": _sinc,
    "tanh": _slope(_tanh),
    "sigmoid": _slope(_sigmoid),
    "sqrt": _slope(_sqrt),
    "cos": _slope(lambda x: (x.cos(), -x.sin())),
    "sin": _slope(lambda x: (x.sin(), x.cos())),
    "cat": _joined(torch.cat),
    "stack": _joined(torch.stack),
    "chunk": lambda x, chunks, _: _split(x, chunks),
    "unbind": lambda x, _: tuple(map(Pushed, x.value.unbind(-1), x.by.unbind(-1))),
    "unsqueeze": lambda x, dim: _along(x, "unsqueeze", dim),
    "sum": lambda x, dim, keepdim=False: _along(x, "sum", dim, keepdim=keepdim),
    "expand_as": _expand_as,
    "dropout": lambda x, *_, **__: x,  # nobody learns to predict by this
    "detach": lambda x: x.value,
    "full_like": lambda x, fill: torch.full_like(x.value, fill),
    "new_tensor": lambda x, data: x.value.new_tensor(data),
}
"""What torch calls an operation -> the same with pushes, as far as the networks need it."""
