"""What tests share: run WGSL on the device, and compare in a way that can fail.

wgsl_eval      one WGSL expression over many inputs
run_stage      one shader over arrays, its outputs filled with a pattern before
unwritten      which elements still hold that pattern
assert_close   comparison with a tolerance that the caller must give
example_kernel a stage with values for the overrides that have no default
example_params values for its ``struct Params``, all of them different
echo_params    what a shader sees of its ``struct Params``
shader_names   every stage, or every include, under the shaders root
"""

from .compare import assert_close
from .evaluate import wgsl_eval
from .params import echo_params, example_params
from .stage import filled, run_stage, unwritten
from .tree import example_kernel, shader_names

__all__ = [
    "assert_close",
    "echo_params",
    "example_kernel",
    "example_params",
    "filled",
    "run_stage",
    "shader_names",
    "unwritten",
    "wgsl_eval",
]
