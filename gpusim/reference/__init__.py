"""Float64 twins of the shader stages, from the equations; they share no code with the shaders."""
