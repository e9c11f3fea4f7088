"""Kernels for pictures: noise of surfaces, and light spread over pixels. They do not import any other package of antdsl."""
