"""Every constant of learned libraries, with its reason. The measured tables behind them are in docs/learning.md."""

import numpy as np

from config.schema import LOADING_FEATURES

# --- the loading curve ------------------------------------------------------------------------------------------------
# Handle force and cable-corrected travel, not the jaws' force and displacement: Eqs. (2) and (6) need the jaws'
# absolute angle, and jaws that have not opened fully after the grasp before start from an unknown one.
MEAN_SAMPLES = 8  # mean of the last samples: 1 to 5 mV of strain noise become 0.1 deg of corrected travel
FORCE_GAPS_DEG = (40.0, 5.0)  # of travel left before the jaws are shut, at which the force is read
MIN_PEAK_SHARE = 0.6  # of most recordings' peak: a weaker one does not set the levels of force for all
CLOSURE_SHARES = (0.45, 0.75)  # of the usual peak force: between them the travel stands for shut jaws
KNEE_SHARE = 0.3  # of the usual peak force: here soft tissue has given way and stiff tissue has not
LEAN_SHARES = (0.45, 0.82)  # of the usual peak force: what still yields between them beyond the cable's stretch
GIVE_SHARES = (0.2, 0.3)  # of the usual peak force: how far the jaws travel between them
YIELD_SHARES = (0.2, 0.5)  # of the usual peak force: how long the drive takes between them
STALLED_SAMPLES = 30  # without a higher force: the drive has stalled, and the loading is over
LOADING_LIMIT_SAMPLES = 60_000  # a minute; a grasp that loads for longer tells nothing more
LOADING_START_SHARE = 0.05  # of the usual peak force over the lowest: the jaws meet something, and the lowest is rest
RAMP_STEP_LOG = 0.1  # ramps are told apart no finer
RAMP_SHARE = 0.9  # of the command's maximum so far, by which the ramp's rate is measured

FEATURES = LOADING_FEATURES  # one force for each of GAPS_DEG
OPENING_UNIT_DEG = 12.0
TRAVEL_UNIT_DEG = 2.0  # below it a travel counts as it is, above it by its logarithm (arcsinh)
FORCE_FLOOR_SHARE = 0.02  # of the usual peak force, added before the logarithm: noise of a force near zero is no news

# --- between recordings -----------------------------------------------------------------------------------------------
# By how much a whole recording differs from another of the same tissue and ramp. Few recordings cannot tell a matrix;
# its shape is stated, its scale is learned where a tissue has several recordings at one ramp.
# 18 deg; 20 % of force, twice; about 0.7 deg, twice; 2.4 % of force; 12 % of time; 1 deg
BETWEEN_SD = np.array([1.5, 0.2, 0.2, 0.35, 0.35, 0.024, 0.12, 0.5])
BETWEEN_CORRELATION = 0.6  # of neighbouring features: a session shifts the curve as a whole
BETWEEN_RANGE = 2.0  # features over which that falls to 1/e
SESSION_SCALE = 0.6  # times BETWEEN_SD: specimen, grip and rig from recording to recording
SESSION_SCALE_WEIGHT = 4.0  # recordings that this prior is worth
RATE_SCALE = 3.0  # times BETWEEN_SD: what another ramp changes for all tissues alike (friction, drive)
RATE_TISSUE_SCALE = 0.7  # times BETWEEN_SD: what it changes for one tissue
TISSUE_SCALE = 20.0  # times BETWEEN_SD: how far apart tissues may lie
RATE_LENGTH_LOG = 1.0  # ramps that differ by a factor e are still alike

# --- within a recording -----------------------------------------------------------------------------------------------
ROBUST_DEGREES_OF_FREEDOM = 4.0  # Student's t by which outlying grasps count less
WITHIN_FLOOR_SHARE = 0.05  # of BETWEEN_SD squared: a recording that repeats itself exactly proves nothing
POOLED_WEIGHT = 15.0  # grasps that the scatter of all tissues together is worth beside a tissue's own
SHAPE_WEIGHT = 5.0  # grasps by which correlations are shrunk

# --- the answer -------------------------------------------------------------------------------------------------------
DEGREES_OF_FREEDOM = 8.0  # of Student's t: a grasp as far out as never seen before may not be sure of its neighbour
UNKNOWN_SCALE = 2.5  # things outside the library scatter by so many spreads of the tissues about their mean
UNKNOWN_DEGREES_OF_FREEDOM = 3.0
CLOSURE_STEP_DEG = 4.0  # of the place where the jaws are shut, by which its influence is found
# How well the grasp before tells where the jaws will be shut: probability and SD, degrees. Mostly it held
# the same tissue; another one may be thicker by 17 degrees.
PREVIOUS_CLOSURE_MIXTURE = ((0.8, 2.5), (0.2, 12.0))
FIRST_GRASP_SCALE = (
    1.0  # times BETWEEN_SD: how far a first grasp, on tissue that is not preconditioned, is from later ones
)

# --- parameters of the filters ----------------------------------------------------------------------------------------
PARAMETER_FLOOR_LOG_SD = 0.05  # no tissue is exactly Eq. (7)
FIT_PRIOR_LOG_SD = (2.0, 1.0, 1.5)  # prior of log alpha, log beta, log d while nothing of the tissue is known
FIT_FORCE_SHARE = 0.05  # of the highest force: how far Eq. (7) may be off
MIN_FIT_SAMPLES = 20  # of a loading
FIT_POINTS = 200  # of a loading, evenly in time
FIT_EFFECTIVE_POINTS = 20.0  # independent points that a loading is worth
