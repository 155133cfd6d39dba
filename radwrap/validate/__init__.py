"""The score card: the product against closed forms and independent quadrature."""
