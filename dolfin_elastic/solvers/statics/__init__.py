"""Nonlinear statics: load steps, arc length, pseudo-transient continuation."""
