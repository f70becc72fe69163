"""Geometry: shapes, distances between them, convex hulls, coal's form of both."""
