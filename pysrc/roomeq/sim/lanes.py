"""Eight boxes or faces at once: vector instructions for the innermost steps of `roomeq.sim.tree`.

They are written in LLVM's language, since its vectoriser passes over loops of eight steps. LLVM translates them for any
processor.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typing import signature
from numba.extending import intrinsic

from roomeq.core.arrays import Array, Number, Numbers

WIDTH = 8
instructions: Any = intrinsic  # for type checkers: what it decorates is called without the first argument
_BITS = ir.IntType(WIDTH)
_FUSED = ("contract",)  # a product and a sum may become one instruction; not for distances, whose bits are stored


class _Lanes:
    """Writes instructions for eight lanes of one type."""

    def __init__(self, context: Any, builder: Any, kind: Any) -> None:
        self.context, self.builder = context, builder
        self.element = context.get_value_type(kind)
        self.type = ir.VectorType(self.element, WIDTH)

    def rows(self, array_type: Any, array: Any) -> Callable[[Any], Any]:
        """Return a function from a number to the place of that row of an array."""
        data = self.context.make_array(array_type)(self.context, self.builder, array).data
        start = self.builder.bitcast(data, self.type.as_pointer())
        return lambda row: self.builder.gep(start, [row])

    def load(self, place: Any) -> Any:
        loaded = self.builder.load(place)
        loaded.align = self.context.get_abi_sizeof(self.element)
        return loaded

    def store(self, value: Any, place: Any) -> None:
        self.builder.store(value, place).align = self.context.get_abi_sizeof(self.element)

    def all(self, value: Any) -> Any:
        """Put one value in all lanes."""
        single = self.builder.insert_element(ir.Constant(self.type, ir.Undefined), value,
                                             ir.Constant(cgutils.int32_t, 0))
        order = ir.Constant(ir.VectorType(cgutils.int32_t, WIDTH), None)
        return self.builder.shuffle_vector(single, ir.Constant(self.type, ir.Undefined), order)

    def constant(self, value: float) -> Any:
        return ir.Constant(self.type, [value] * WIDTH)

    def least(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered("<", a, b), a, b)

    def most(self, a: Any, b: Any) -> Any:
        return self.builder.select(self.builder.fcmp_ordered(">", a, b), a, b)

    def dot(self, row: Callable[[Any], Any], first: int, vector: Any, flags: Any = ()) -> Any:
        """Return the sum of three rows times three vectors."""
        x, y, z = (self.builder.fmul(self.load(row(ir.Constant(cgutils.intp_t, first + n))), vector[n], flags=flags)
                   for n in range(3))
        return self.builder.fadd(self.builder.fadd(x, y, flags=flags), z, flags=flags)

    def bits(self, lanes: Any) -> Any:
        """Return eight truth values as the bits of a number."""
        return self.builder.zext(self.builder.bitcast(lanes, _BITS), cgutils.intp_t)


@instructions
def meet_boxes(typing: Any, box: Array, sides: Numbers, origin: Numbers, per_m: Numbers, most: Number,
               near: Array) -> Any:
    """Return which of eight boxes a ray meets, as bits, and write where it enters them to `near`.

    Parameters
    ----------
    box : ndarray of float32, shape (6, 8)
        Low and high x, y and z of each box.
    sides : tuple of 3 int
        Along each axis 0 if the ray points up, 1 if down.
    origin, per_m : tuple of 3 float32
        Where the ray starts, and the inverse of its direction.
    most : float32
        Length of the ray.
    near : ndarray of float32, shape (8,)
    """
    def generate(context: Any, builder: Any, of_call: Any, arguments: Any) -> Any:
        lanes = _Lanes(context, builder, types.float32)
        row = lanes.rows(of_call.args[0], arguments[0])
        near = lanes.rows(of_call.args[5], arguments[5])(ir.Constant(cgutils.intp_t, 0))
        sides, origin, per_m = (cgutils.unpack_tuple(builder, argument, 3) for argument in arguments[1:4])
        enters, leaves = lanes.constant(0.0), lanes.all(arguments[4])
        for axis in range(3):
            at, scale = lanes.all(origin[axis]), lanes.all(per_m[axis])
            low = builder.add(sides[axis], ir.Constant(sides[axis].type, 2 * axis))
            high = builder.sub(ir.Constant(sides[axis].type, 2 * axis + 1), sides[axis])
            first, last = (builder.fmul(builder.fsub(lanes.load(row(side)), at), scale) for side in (low, high))
            # in this order, a ray of which a number is missing meets nothing
            enters, leaves = lanes.most(first, enters), lanes.least(leaves, last)
        lanes.store(enters, near)
        return lanes.bits(builder.fcmp_ordered("<=", enters, leaves))

    three = types.UniTuple(types.float32, 3)
    return signature(types.intp, box, types.UniTuple(types.intp, 3), three, three, types.float32, near), generate


@instructions
def meet_faces(typing: Any, planes: Array, origin: Numbers, way: Numbers, least_approach: Number, behind_m: Number,
               reach: Array) -> Any:
    """Return which of eight triangles or quadrangles a ray meets, as bits, and write how far they are to `reach`.

    Parameters
    ----------
    planes : ndarray of float64, shape (20, 8)
        See `roomeq.sim.tree.Tree`.
    origin, way : tuple of 3 float64
        Where the ray starts, and its direction.
    least_approach : float64
        To the front of a face, for each unit of the ray's length; negative where it leaves through a back.
    behind_m : float64
        How far beyond a plane it may start.
    reach : ndarray of float64, shape (8,)
    """
    def generate(context: Any, builder: Any, of_call: Any, arguments: Any) -> Any:
        lanes = _Lanes(context, builder, types.float64)
        row = lanes.rows(of_call.args[0], arguments[0])
        reach = lanes.rows(of_call.args[5], arguments[5])(ir.Constant(cgutils.intp_t, 0))
        origin, way = ([lanes.all(part) for part in cgutils.unpack_tuple(builder, argument, 3)]
                       for argument in arguments[1:3])
        least_approach, behind_m = (lanes.all(argument) for argument in arguments[3:5])

        def offset(first: int) -> Any:
            return lanes.load(row(ir.Constant(cgutils.intp_t, first + 3)))

        height = builder.fsub(lanes.dot(row, 0, origin), offset(0))
        approach = builder.fsub(lanes.constant(-0.0), lanes.dot(row, 0, way))
        distance = builder.fdiv(height, approach)
        size = lanes.most(approach, builder.fsub(lanes.constant(-0.0), approach))
        ahead = builder.fadd(builder.fmul(height, approach), builder.fmul(behind_m, size))
        met = builder.and_(builder.fcmp_ordered(">", approach, least_approach),
                           builder.fcmp_ordered(">", ahead, lanes.constant(0.0)))
        point = [builder.fadd(start, builder.fmul(distance, along, flags=_FUSED), flags=_FUSED)
                 for start, along in zip(origin, way, strict=True)]
        for edge in (4, 8, 12, 16):
            met = builder.and_(met, builder.fcmp_ordered(">", lanes.dot(row, edge, point, _FUSED), offset(edge)))
        lanes.store(distance, reach)
        return lanes.bits(met)

    three = types.UniTuple(types.float64, 3)
    return signature(types.intp, planes, three, three, types.float64, types.float64, reach), generate


@instructions
def lowest(typing: Any, bits: Number) -> Any:
    """Return the place of the lowest bit of a number other than 0."""
    def generate(context: Any, builder: Any, of_call: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.Constant(ir.IntType(1), 1))

    return signature(types.intp, types.intp), generate
