"""The ceiling: somebody who knows every exact signature and the noise, and has only to choose.

Here: signatures written a second time, without the diagnosis or its catalogue. Not here: answers of the product.
"""
