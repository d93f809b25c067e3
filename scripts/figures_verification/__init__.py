"""The program held against closed forms: cases, their table and their figure."""
