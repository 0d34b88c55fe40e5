"""Constants for studies: things outside the library to grasp, and deviations of the truth from the model."""

from acquisition.simulation.tissue import ModelDeviation
from config.load import load_library

OUT_OF_LIBRARY = load_library("out_of_library")

FOAM_DEVIATION = ModelDeviation(plateau_n=0.6, plateau_m=4e-4)
DEVIATION_BY_TISSUE = {"foam": FOAM_DEVIATION}
# of a tissue of the library that slides out of the jaws
SLIPPING_DEVIATION = ModelDeviation(slips_after_s=0.08, slips_within_s=0.3)

HUNT_CROSSLEY = "Hunt-Crossley damping, seven times at the peak"
MISMATCHES = {
    "matched": ModelDeviation(),
    "Hunt-Crossley damping, by force": ModelDeviation(hunt_crossley=True),
    HUNT_CROSSLEY: ModelDeviation(damping_at_peak=7.0),
    "relaxation 10 %": ModelDeviation(relaxed_share=0.10),
    "relaxation 30 %": ModelDeviation(relaxed_share=0.30),
    "relaxation 30 %, fast": ModelDeviation(relaxed_share=0.30, relaxation_s=0.1),
    "touch 25 µm late": ModelDeviation(touch_late_m=25e-6),
    "touch 100 µm late": ModelDeviation(touch_late_m=100e-6),
    "force scale +10 %": ModelDeviation(force_scale=1.1),
    "force scale -10 %": ModelDeviation(force_scale=0.9),
    "displacement off by 50 µm": ModelDeviation(backlash_m=50e-6),
    "breathing, 0.25 Hz, 0.2 mm": ModelDeviation(motion_m=2e-4, motion_hz=0.25),
    "heartbeat, 1.5 Hz, 0.05 mm": ModelDeviation(motion_m=5e-5, motion_hz=1.5),
    "mass 2 g": ModelDeviation(mass_kg=0.002),
    "mass 20 g": ModelDeviation(mass_kg=0.020),
    "cable friction 5 %": ModelDeviation(friction_share=0.05),
}
