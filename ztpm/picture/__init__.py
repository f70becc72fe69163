"""Pictures of an assessment: a PNG by matplotlib, and one HTML file by a vendored three.js."""
