"""Kernels for rendering: noise on surfaces, and light of samples that is spread over pixels. They import no other package of
antdsl."""
