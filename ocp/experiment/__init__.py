"""The paper's experiments on virtual robots: positions before and after, force at working points (`ocp.experiments`)."""
