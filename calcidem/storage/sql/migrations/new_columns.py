"""Columns that migrations add, apart from them: workers know the tables without alembic."""

NEW_COLUMNS = {  # 0006, with the kinds of their checks
    "distance": "positive",
    "wavelengths_on_path": "positive",
    "wavelength_over_d50": "positive",
    "expected_error": "not_negative",
    "content_of_contacts": "not_negative",
    "static_speed": "positive",
}
BROKEN_BONDS = "broken_bonds"  # 0007
