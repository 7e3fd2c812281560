"""The grinding-force log as a channel of the diagnosis: its nuisance, the columns of every effect, folds, sealed rows."""
