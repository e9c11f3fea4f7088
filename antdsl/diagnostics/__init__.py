"""Complaints and how they are shown."""

from antdsl.diagnostics.model import Diagnostic, Fix, Label, Report

__all__ = ["Diagnostic", "Fix", "Label", "Report"]
