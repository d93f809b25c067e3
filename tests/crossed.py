"""Two fractures that cross in unmeshed rock and open under pressure, for tests of physics and of solvers."""

ROCK = """
rock.rock = {youngs_modulus = 50e9, poissons_ratio = 0.25}
"""
CROSSED = (
    ROCK
    + """
initial_stress = {xx = -8e6, yy = -12e6, zz = -10e6, xy = 2e6}
fluid = {viscosity = 1e-3, initial_pressure = 0}
stage = [{kind = "steady", time_step = 0.25, steps = 4}]
geometry = {domain = "unbounded", size_at_fractures = 0.05, size_at_tips = 0.0125, fracture = [
  {name = "a", points = [[-1, 0], [1, 0.2]]},
  {name = "b", points = [[-0.6, -0.8], [0.5, 0.9]]},
]}
[fracture.default]
normal_stiffness = 1e11
shear_stiffness = 1e11
aperture = 1e-3
friction_coefficient = 0.5
pressure = [[0, 0], [1, 11e6]]
"""
)
