"""Any levels of the sources without a ray."""
