"""Findings and their output formats."""

from antdsl.diagnostics.model import Diagnostic, Fix, Label, Report

__all__ = ["Diagnostic", "Fix", "Label", "Report"]
