"""The class Specimen, the simulated grasper's tissue, and the function that integrates its deformation."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acquisition.compilation import compiled
from config.schema import TissueLibrary, TissueProfile

SUBSTEPS = 5  # stable up to 1e6 N/m on 5 g
HUNT_CROSSLEY_REFERENCE_N = 1.0  # elastic force at which damping that grows with force equals the profile's
GRASP_SCATTER_LOG_SD = (0.03, 0.01, 0.05)  # of log alpha, beta, d of grasps on one spot; assumed
PEAK_FORCE_N = 1.55  # of the paper's protocols, where damping that grows with displacement reaches its peak


@dataclass(frozen=True, slots=True)
class ModelDeviation:
    """Deviations of the simulated truth from the estimator's assumptions; none by default."""

    mass_kg: float | None = None  # instead of the library's
    hunt_crossley: bool = False  # damping in proportion to the elastic force instead of constant
    damping_at_peak: float = 0.0  # times the profile's at the peak, if damping grows in proportion to displacement
    relaxed_share: float = 0.0  # share of the elastic force that relaxes while the tissue is held
    relaxation_s: float = 0.5
    plateau_n: float = 0.0  # force of buckling cell walls of a foam, reached from `plateau_m` on
    plateau_m: float = 1e-3
    motion_m: float = 0.0  # motion of the tissue against the jaws by breathing or heartbeat
    motion_hz: float = 0.25
    slips_after_s: float = math.inf  # contact time at which the tissue begins to slide out of the jaws
    slips_within_s: float = 0.3
    touch_late_m: float = 0.0  # compression before the touch sensors detect contact
    force_scale: float = 1.0  # of the strain gage
    backlash_m: float = 0.0  # motion that the encoder senses and the jaws do not make, while the cable tightens
    friction_share: float = (
        0.0  # of the force: friction of the cable, which the strain gage senses with the motion's sign
    )


NO_DEVIATION = ModelDeviation()


class Material(NamedTuple):
    """m x'' + damping + alpha (exp(beta x) - 1) + plateau - relaxed = u; Eq. (7) where the rest is zero."""

    alpha_n: float
    beta_per_m: float
    damping_kg_per_s: float
    mass_kg: float
    plateau_n: float = 0.0
    plateau_m: float = 1.0
    damping_by_force: float = 0.0  # 1: Hunt-Crossley
    relaxed_share: float = 0.0
    relaxation_s: float = 1.0
    damping_per_m: float = 0.0  # damping in proportion to displacement: times the profile's, per meter


@dataclass(frozen=True, slots=True)
class Specimen:
    """One piece of tissue, drawn from its profile's spread. Of a fold held at a preload, alpha contains the preload."""

    tissue: str
    material: Material
    thickness_m: float

    @property
    def log_parameters(self) -> np.ndarray:
        """Log alpha, log beta and log d, (3,)."""
        return np.log([self.material.alpha_n, self.material.beta_per_m, self.material.damping_kg_per_s])

    @classmethod
    def draw(cls, library: TissueLibrary, tissue: str, scatter: list[float], deviation: ModelDeviation) -> "Specimen":
        """Draw a specimen.

        `scatter`: deviations of log alpha, beta, d, thickness and preload in standard deviations.
        """
        profile, spread = library.tissues[tissue], library.spread_of(tissue)
        alpha_n = profile.alpha_n * math.exp(spread.log_alpha * scatter[0]) + _draw_preload(profile, scatter[4])
        beta_per_m = profile.beta_per_m * math.exp(spread.log_beta * scatter[1])
        peak_m = math.log1p(PEAK_FORCE_N / alpha_n) / beta_per_m
        material = Material(
            alpha_n,
            beta_per_m,
            profile.damping_kg_per_s * math.exp(spread.log_damping * scatter[2]),
            deviation.mass_kg or library.mass_kg,
            deviation.plateau_n,
            deviation.plateau_m,
            float(deviation.hunt_crossley),
            deviation.relaxed_share,
            deviation.relaxation_s,
            deviation.damping_at_peak / peak_m,
        )
        return cls(tissue, material, profile.thickness_m * math.exp(spread.log_thickness * scatter[3]))


def _draw_preload(profile: TissueProfile, scatter: float) -> float:
    """Return the preload of a fold, N; 0 for tissue that the jaws take whole."""
    if profile.preload_n is None:
        return 0.0
    low_n, high_n = profile.preload_n
    return low_n * (high_n / low_n) ** (0.5 * math.erfc(-scatter / math.sqrt(2.0)))  # a share that is uniform in [0, 1]


@compiled
def integrate_tissue(
    x_m: float,
    v_m_per_s: float,
    relaxed_n: float,
    begin_n: float,
    end_n: float,
    dt_s: float,
    moved_m: float,
    material: Material,
) -> tuple[float, float, float]:
    """Return displacement, velocity and relaxed force after `dt_s`, under a force linear from `begin_n` to `end_n`.

    `moved_m` is how far the tissue has been moved against the jaws. The method, 4th-order Runge-Kutta, differs from the
    estimator's on purpose.
    """
    step_s, half_s = dt_s / SUBSTEPS, 0.5 * dt_s / SUBSTEPS
    for k in range(SUBSTEPS):
        first_n = begin_n + (end_n - begin_n) * k / SUBSTEPS
        last_n = begin_n + (end_n - begin_n) * (k + 1) / SUBSTEPS
        middle_n = 0.5 * (first_n + last_n)
        v1 = v_m_per_s
        a1, r1 = _compute_derivatives(x_m + moved_m, v1, relaxed_n, first_n, material)
        v2 = v1 + half_s * a1
        a2, r2 = _compute_derivatives(x_m + moved_m + half_s * v1, v2, relaxed_n + half_s * r1, middle_n, material)
        v3 = v1 + half_s * a2
        a3, r3 = _compute_derivatives(x_m + moved_m + half_s * v2, v3, relaxed_n + half_s * r2, middle_n, material)
        v4 = v1 + step_s * a3
        a4, r4 = _compute_derivatives(x_m + moved_m + step_s * v3, v4, relaxed_n + step_s * r3, last_n, material)
        x_m += step_s / 6 * (v1 + 2 * (v2 + v3) + v4)
        v_m_per_s += step_s / 6 * (a1 + 2 * (a2 + a3) + a4)
        relaxed_n += step_s / 6 * (r1 + 2 * (r2 + r3) + r4)
    return x_m, v_m_per_s, relaxed_n


@compiled
def _compute_derivatives(
    x_m: float, v_m_per_s: float, relaxed_n: float, force_n: float, material: Material
) -> tuple[float, float]:
    """Return the acceleration, m/s², and the growth of the relaxed part of the elastic force, N/s."""
    elastic_n = material.alpha_n * math.expm1(min(material.beta_per_m * x_m, 50.0))
    if material.plateau_n > 0.0 and x_m > 0.0:
        elastic_n -= material.plateau_n * math.expm1(-x_m / material.plateau_m)
    if material.damping_by_force > 0.0:
        share = material.damping_by_force * max(elastic_n, 0.0) / HUNT_CROSSLEY_REFERENCE_N
    elif material.damping_per_m > 0.0:
        share = material.damping_per_m * max(x_m, 0.0)
    else:
        share = 1.0
    damping = material.damping_kg_per_s * share
    acceleration = (force_n - damping * v_m_per_s - elastic_n + relaxed_n) / material.mass_kg
    return acceleration, (material.relaxed_share * elastic_n - relaxed_n) / material.relaxation_s
