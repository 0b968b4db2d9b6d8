"""The language AS: syntax, values, expressions, and the check of a file. It needs no robot."""
