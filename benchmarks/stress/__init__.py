"""The stress scenarios of numerical stability, and the scenes that the tests share with them."""
