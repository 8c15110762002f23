"""`python -m polishopt.texture surface.x3p` measures a surface: see `polishopt.measure`."""

from ..measure import run


if __name__ == "__main__":
    run()
