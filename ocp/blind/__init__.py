"""The blind check: worlds drawn and sealed, answers, the scorer that opens the labels afterwards."""
