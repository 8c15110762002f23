"""Optimize: constrained least squares and minimisation, and what is built on them."""

from .auglag import minimise as minimise, solve as solve
from .box import BoxLevenbergMarquardt as BoxLevenbergMarquardt
from .certificate import Solution as Solution, Status as Status, sentence as sentence
from .naming import active as active, conflict as conflict
from .values import Values as Values
