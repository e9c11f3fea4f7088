"""Kernels of pictures: noise of surfaces, and light spread over pixels. They need no other package of antdsl."""
