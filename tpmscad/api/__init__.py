"""The interface of public functions: what every argument of a public function takes, and what passes on the way in and out.

An argument is declared once, as the annotation of the function that takes it; see `argument_kinds` and `public_calls`.
"""
