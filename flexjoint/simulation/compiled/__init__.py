"""The clockwork as C: compiled once per structure of a model, cached per user; and which runs take it."""

from flexjoint.simulation.compiled.compiler import CompilerError
from flexjoint.simulation.compiled.model import CompiledModel, Job, Rows
from flexjoint.simulation.compiled.rates import CompiledRates
from flexjoint.simulation.compiled.shared import compiled_for

__all__ = ["CompiledModel", "CompiledRates", "CompilerError", "Job", "Rows", "compiled_for"]
