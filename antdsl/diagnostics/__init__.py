"""Findings about programs and scenes, and the formats in which they are written."""

from antdsl.diagnostics.model import Diagnostic, Fix, Label, Report

__all__ = ["Diagnostic", "Fix", "Label", "Report"]
