"""S10, small: iterations for one tight joint, as Newton's method on one opening predicts them; and the closed form."""

import pytest

pytestmark = pytest.mark.serial


def test_small_map(tmp_path):
    from figures_stability import s10

    checks = s10.draw(tmp_path, small=True)
    assert len(checks) == 7 and [check for check in checks if not check.ok] == []
    assert (tmp_path / "s10.png").stat().st_size > 30_000
    assert "closure,jump,iterations,predicted" in (tmp_path / "s10.csv").read_text()


@pytest.mark.parametrize("closure", [1e-3, 0.3, 10.0])
@pytest.mark.parametrize("jump", [-0.9, -0.01, 0.5, 1.5, 12.0])
def test_the_opening_balances(closure, jump):
    from figures_stability import s10

    e = s10.opening(closure, jump)
    traction = closure * e / (1.0 + e) if e < 0.0 else min(closure * e, 1.0)
    assert e > -1.0
    assert traction + s10.BARS * s10.APERTURE / s10.LOAD * e == pytest.approx(jump, rel=1e-10)
