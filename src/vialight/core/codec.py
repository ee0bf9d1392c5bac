"""Messages as bytes and back: data by a schema, in MessagePack; what is read can run nothing.

The schema is the type of the message itself, a dataclass or a named tuple with its fields' types.  Arrays go as their
type, their shape and their values; what does not fit the schema is refused.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, get_args, get_origin

import msgspec
import numpy as np

_Array = tuple[str, tuple[int, ...], bytes]
"""An array on its way: type, shape, values."""


def encode(message: object) -> bytes:
    """Return a message as bytes.

    Examples
    --------
    >>> decoder_of(tuple[int, float])(encode((3, 0.5)))
    (3, 0.5)
    """
    return _ENCODER.encode(message)


def decoder_of(kind: Any) -> Callable[[bytes], Any]:
    """Return what reads messages of a kind; it raises `ValueError` where bytes are none."""
    decode = _decoder(kind).decode

    def read(content: bytes) -> Any:
        try:
            return decode(content)
        except (msgspec.MsgspecError, OverflowError) as error:
            raise ValueError(f"is no {getattr(kind, '__name__', kind)} ({error})") from error

    return read


@functools.cache
def _decoder(kind: Any) -> msgspec.msgpack.Decoder[Any]:
    return msgspec.msgpack.Decoder(kind, dec_hook=_restored)


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        whole = np.ascontiguousarray(value)
        return whole.dtype.str, whole.shape, whole.reshape(-1).view(np.uint8).data
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"a message cannot hold {type(value).__name__}")


def _restored(kind: Any, value: Any) -> Any:
    if get_origin(kind) is not np.ndarray:
        raise NotImplementedError(f"a message cannot hold {kind}")
    dtype, shape, values = msgspec.convert(value, _Array)
    wanted = np.dtype(get_args(get_args(kind)[1])[0])
    if np.dtype(dtype) != wanted:
        raise ValueError(f"an array of {dtype} where {wanted} is wanted")
    if min(shape, default=0) < 0 or math.prod(shape) * wanted.itemsize != len(values):
        raise ValueError(f"an array of shape {shape} with {len(values)} bytes")
    return np.frombuffer(values, wanted).reshape(shape)


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_plain)
