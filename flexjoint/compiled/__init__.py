"""The clockwork as C: generated, compiled once per structure of a model, cached per user."""

from flexjoint.compiled.compiler import CompilerError
from flexjoint.compiled.model import CompiledModel, Job, Rows
from flexjoint.compiled.rates import CompiledRates
from flexjoint.compiled.shared import compiled_for

__all__ = ["CompiledModel", "CompiledRates", "CompilerError", "Job", "Rows", "compiled_for"]
