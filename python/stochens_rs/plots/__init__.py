"""How arrays become figures; knows no record."""
