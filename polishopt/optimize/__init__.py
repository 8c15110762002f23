"""Optimize: constrained nonlinear least squares, and what is built on it."""

from .auglag import minimise as minimise, solve as solve
from .box import BoxLevenbergMarquardt as BoxLevenbergMarquardt
from .certificate import Solution as Solution, Status as Status, sentence as sentence
