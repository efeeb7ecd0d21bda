"""The verbs of `hatn-sim`, a module each: `add_arguments(parser)` and `main(arguments)`.

Nothing heavy is imported before `main`, so that `--help` answers at once.
"""
