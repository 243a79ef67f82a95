"""Rotations about one axis by the right-hand rule, as 3x3 lists of rows; angles in degrees."""
import math

IDENTITY = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]


def product(*factors):
    result = IDENTITY
    for f in factors:
        result = [[sum(row[k] * f[k][j] for k in range(3)) for j in range(3)] for row in result]
    return result


def turned(rotation, vector):
    return [sum(row[k] * vector[k] for k in range(3)) for row in rotation]


def about(axis, degrees):
    """About any unit axis (Rodrigues)."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    x, y, z = axis
    return [[c + x * x * (1 - c), x * y * (1 - c) - z * s, x * z * (1 - c) + y * s],
            [y * x * (1 - c) + z * s, c + y * y * (1 - c), y * z * (1 - c) - x * s],
            [z * x * (1 - c) - y * s, z * y * (1 - c) + x * s, c + z * z * (1 - c)]]


def x(degrees):
    return about((1, 0, 0), degrees)


def y(degrees):
    return about((0, 1, 0), degrees)


def z(degrees):
    return about((0, 0, 1), degrees)
