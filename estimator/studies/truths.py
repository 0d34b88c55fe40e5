"""What the studies put between the jaws besides the library's tissues, and how truth differs from the model."""

from acquisition.simulation.tissue import Deviation
from config.schema import Spread, TissueLibrary, TissueProfile

FILLS_THE_JAWS_M = 0.026
NARROW = Spread(log_alpha=0.25, log_beta=0.10, log_damping=0.30)


def _thing(title: str, alpha_n: float, beta_per_m: float, damping_kg_per_s: float, thickness_m: float) -> TissueProfile:
    return TissueProfile(
        title=title, alpha_n=alpha_n, beta_per_m=beta_per_m, damping_kg_per_s=damping_kg_per_s,
        thickness_m=thickness_m, threshold_pa=60e3, spread=NARROW,
    )  # fmt: skip


STRANGERS = TissueLibrary(
    name="strangers",
    title="Things outside the default library",
    source="assumed; spleen about 1/36 of liver's stiffness, the rest about the library's tissues",
    mass_kg=0.005,
    jaw_area_m2=56.3e-6,
    spread=NARROW,
    tissues={
        "spleen": _thing("Spleen, 1/36 of liver", 0.8492 / 36, 1909.0, 3.1, 0.0075),
        "fibrotic_liver": _thing("Liver, 6 times as stiff", 0.8492 * 6, 1909.0, 6.0, 0.0075),
        "fibrotic_bowel": _thing("Small bowel, 8 times as stiff", 0.5189 * 8, 2158.0, 6.0, 0.0055),
        "foam": _thing("Foam: walls buckle, then it densifies", 0.004, 900.0, 4.0, FILLS_THE_JAWS_M),
        "instrument": _thing("Another instrument, 200 kN/m", 400.0, 500.0, 20.0, 0.005),
        "empty_jaws": _thing("Nothing: jaw on jaw", 400.0, 500.0, 20.0, 0.0002),
    },
)

FOAM = Deviation(plateau_n=0.6, plateau_m=4e-4)
DEVIATION_OF = {"foam": FOAM}
SLIPPING = Deviation(slips_after_s=0.08, slips_within_s=0.3)  # of a tissue of the library: it slides out of the jaws

MISMATCHES = {
    "matched": Deviation(),
    "Hunt-Crossley damping": Deviation(hunt_crossley=True),
    "relaxation 10 %": Deviation(relaxed_share=0.10),
    "relaxation 30 %": Deviation(relaxed_share=0.30),
    "relaxation 30 %, fast": Deviation(relaxed_share=0.30, relaxation_s=0.1),
    "touch 25 µm late": Deviation(touch_late_m=25e-6),
    "touch 100 µm late": Deviation(touch_late_m=100e-6),
    "force scale +10 %": Deviation(force_scale=1.1),
    "force scale -10 %": Deviation(force_scale=0.9),
    "displacement off by 50 µm": Deviation(backlash_m=50e-6),
    "breathing, 0.25 Hz, 0.2 mm": Deviation(motion_m=2e-4, motion_hz=0.25),
    "heartbeat, 1.5 Hz, 0.05 mm": Deviation(motion_m=5e-5, motion_hz=1.5),
    "mass 2 g": Deviation(mass_kg=0.002),
    "mass 20 g": Deviation(mass_kg=0.020),
    "cable friction 5 %": Deviation(friction_share=0.05),
}
