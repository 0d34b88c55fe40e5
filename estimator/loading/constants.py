"""Every constant of learned libraries, with its reason. The measured tables behind them are in docs/learning.md."""

import numpy as np

from config.schema import LOADING_FEATURES

# --- the loading curve ------------------------------------------------------------------------------------------------
# Handle force and cable-corrected travel, not the jaws' force and displacement: Eqs. (2) and (6) need the jaws'
# absolute angle, which is unknown if the jaws did not open fully after the previous grasp.
MEAN_SAMPLES = 8  # mean of the last samples: 1 to 5 mV of strain noise become 0.1 deg of corrected travel
FORCE_GAPS_DEG = (40.0, 5.0)  # travel left before jaw closure at which the force is read
MIN_PEAK_SHARE = 0.6  # share of the recordings' median peak below which a recording does not set the usual peak
CLOSURE_SHARES = (0.45, 0.75)  # shares of the usual peak force: the jaws count as shut at the travel between them
KNEE_SHARE = 0.3  # share of the usual peak force: soft tissue has given way here, stiff tissue has not
LEAN_SHARES = (0.45, 0.82)  # shares of the usual peak force: travel between them, without the cable's stretch
GIVE_SHARES = (0.2, 0.3)  # shares of the usual peak force: travel of the jaws between them
YIELD_SHARES = (0.2, 0.5)  # shares of the usual peak force: time between them
STALLED_SAMPLES = 30  # samples without a higher force after which the drive has stalled and the loading is over
LOADING_LIMIT_SAMPLES = 60_000  # a minute; a longer loading adds no information
LOADING_START_SHARE = 0.05  # share of the usual peak force over the lowest: the jaws meet something
SHUT_TRAVEL_DEG = 134.0  # of the Smart Tool's encoder, through its opening of 10 mm, Eq. (6); the unit of other travels
RAMP_STEP_LOG = 0.1  # resolution of ramps
RAMP_SHARE = 0.9  # share of the command's maximum so far up to which the ramp's rate is measured

FEATURES = LOADING_FEATURES  # one force for each of FORCE_GAPS_DEG
OPENING_UNIT_DEG = 12.0
TRAVEL_UNIT_DEG = 2.0  # a smaller travel counts linearly, a larger one by its logarithm (arcsinh)
FORCE_FLOOR_SHARE = 0.02  # share of the usual peak force added before the logarithm, to damp noise near zero

# --- between spots ----------------------------------------------------------------------------------------------------
# A few spots cannot determine a matrix, so the shape of the differences between tissues and ramps is stated:
# 18 deg; 20 % of force, twice; about 0.7 deg, twice; 2.4 % of force; 12 % of time; 1 deg
BETWEEN_SD = np.array([1.5, 0.2, 0.2, 0.35, 0.35, 0.024, 0.12, 0.5])
BETWEEN_CORRELATION = 0.6  # of neighboring features: a spot shifts the curve as a whole
BETWEEN_RANGE = 2.0  # number of features over which the correlation falls to 1/e
RATE_SCALE = 3.0  # times BETWEEN_SD: effect of another ramp on all tissues alike (friction, drive)
RATE_TISSUE_SCALE = 0.7  # times BETWEEN_SD: effect of another ramp on one tissue
TISSUE_SCALE = 20.0  # times BETWEEN_SD: distance between tissues
RATE_LENGTH_LOG = 1.0  # ramps that differ by a factor e are still similar
# Spread between spots of one tissue at one ramp, before any pair of spots is seen. On repeated recordings of 2013,
# forces, knee, lean, yield and give differ 2 to 3 times as much as the scatter between organs had suggested; the way
# to reopen and the stall repeat. 8 deg; 36 % of force, twice; 1.4 deg; 0.9 deg; 1.2 % of force; 18 % of time; 1.2 deg
SPOT_SD = np.array([0.68, 0.36, 0.36, 0.63, 0.42, 0.012, 0.18, 0.6])
PRIOR_PAIRS = 2.0  # weight of SPOT_SD, in pairs of spots
TISSUE_TO_SPOT_RATIO = 3.0  # spread between tissues over that between spots, before the library's tissues are seen
PRIOR_TISSUES = 2.0  # weight of this prior, in tissues

# --- within a recording -----------------------------------------------------------------------------------------------
ROBUST_DEGREES_OF_FREEDOM = 4.0  # of the Student's t that gives outlying grasps less weight
WITHIN_FLOOR_SHARE = 0.05  # share of BETWEEN_SD squared: least variance, however well a recording repeats itself
POOLED_WEIGHT = 15.0  # weight of the scatter of all tissues beside a tissue's own, in grasps
SHAPE_WEIGHT = 5.0  # strength of the shrinkage of correlations, in grasps

# --- the answer -------------------------------------------------------------------------------------------------------
GRASP_DEGREES_OF_FREEDOM = 8.0  # of Student's t, at most: a grasp far from all spots must not give a sure answer
# Probability, before a grasp, that the tissue is none of the library's. It is more than the settings' default,
# because a learned library holds few tissues: with any one of them left out, few of its grasps may get another's name.
PRIOR_UNKNOWN = 0.125
CLOSURE_STEP_DEG = 4.0  # step of the jaw closure angle for the features' sensitivity to it
# How well the previous grasp predicts the jaw closure angle: probability and SD, degrees. Mostly it held the same
# tissue; another one may be thicker by 17 degrees.
PREVIOUS_CLOSURE_MIXTURE = ((0.8, 2.5), (0.2, 12.0))
# SD of log stall between two days that no reference grasps link. It is assumed: drive and cable change with age,
# temperature and the tool's assembly, and no recordings of two days exist.
REFERENCE_STALL_SD = 0.03
MIN_REFERENCE_GRASPS = 3  # for a median and a scatter
# Share of the stall to which the force of empty jaws may rise up to 5 degrees before closure: drag is about 0.02 with a
# ramp of 1 s; the tissues of 2013 reach 0.08 to 0.31 there.
EMPTY_FORCE_SHARE = 0.06
REFERENCE_SMOOTHING_S = 0.05  # a twentieth of the ramp: the noise of single samples would bias the slope
FIRST_GRASP_SCALE = 1.0  # times BETWEEN_SD: the first grasp on a spot differs, because the tissue is not preconditioned

# --- parameters of the filters ----------------------------------------------------------------------------------------
PARAMETER_FLOOR_LOG_SD = 0.05  # no tissue follows Eq. (7) exactly
FIT_PRIOR_LOG_SD = (2.0, 1.0, 1.5)  # prior of log alpha, log beta, log d without knowledge of the tissue
FIT_FORCE_SHARE = 0.05  # error of Eq. (7), as a share of the highest force
MIN_FIT_SAMPLES = 20  # of a loading
FIT_POINTS = 200  # of a loading, evenly in time
FIT_EFFECTIVE_POINTS = 20.0  # independent points in a loading
