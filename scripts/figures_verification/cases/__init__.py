"""One module a reference: its closed form with its source, and the runs that are held against it."""

from figures_verification.cases import r01, r02, r03, r04, r05, r06, r07, r08, r11, r12, r14, r15, r16, r17, r18, r19

MODULES = (r01, r02, r03, r04, r05, r06, r07, r08, r11, r12, r14, r15, r16, r17, r18, r19)
CASES = tuple(case for module in MODULES for case in module.CASES)
