"""Every constant of the estimation, with its reason. Values that a user may change are in `graspwatch.toml`.

The paper does not state P0, Qw, R and the initial guesses; this file does. No value was fitted to a study's seed: each
follows from the sensor chain, or was chosen on simulated grasps with other seeds (decisions 2, 3 and 8 to 10).
"""

import numpy as np

# --- where a grasp starts ---------------------------------------------------------------------------------------------
PRIOR_SD_FACTOR = 2.0  # a filter's prior is wider than its tissue's spread, so that it can follow similar tissues
# A touch sensor reports contact up to a sample (30 µm) late and needs some pressure itself. With this SD the filters
# can find up to 0.1 mm of compression from the data.
INITIAL_COMPRESSION_M = 28e-6
INITIAL_COMPRESSION_SD_M = 38e-6
VELOCITY_SD_M_PER_S = 0.05  # the jaws arrive at about 30 mm/s
UNDETECTED_FORCE_N = 0.005  # scale of the force before the back-dated contact; see decision 4

# --- noise ------------------------------------------------------------------------------------------------------------
FORCE_NOISE_SD_N = 0.001  # force that the strain gage does not measure: motion of the tissue, roughness of the drive
DISPLACEMENT_NOISE_SD_M = 0.5e-6  # rounding to an encoder count of about 1 µm at the jaws, with a margin
LOG_WALK_SD = np.array([1e-4, 1e-4, 5e-4])  # per sample: log alpha, beta, d drift slowly under load
REST_SAMPLES = 400  # samples before a grasp that give the strain noise, to 6 %
MIN_REST_SAMPLES = 100  # with fewer, the tool file's noise counts
REST_SETTLING_SAMPLES = 100  # samples after a grasp in which the jaws still open
REST_VARIANCE_RANGE = (0.1, 100.0)  # times the tool file's variance: the measured variance is clipped to this range

# --- trust in the model: each tissue has a strict and a lenient filter, and the data choose (decision 8) --------------
STRICT_LOG_MASS_SD = 0.05  # practically known
STRICT_DYNAMIC_SHARE = 0.2  # damping and inertial force may be wrong by this share, sample by sample
LENIENT_LOG_MASS_SD = 0.8  # the moving mass depends on the amount of tissue held: 5 g within a factor of 2.2
LENIENT_DYNAMIC_SHARE = 0.3  # damping may grow with the force (Hunt-Crossley), friction may act
# Share of the force squared, per second: the tissue leaves its curve by 5 % in 0.1 s, because it relaxes, slides, or
# the body moves it. The floor takes the place of a force near zero.
LENIENT_DRIFT_RATE = 0.03
DRIFT_FLOOR_N = 0.05

# For real tissue with a learned library: no alpha and beta fit a whole loading, and cable and drive have friction.
# With these values, filters follow 98 of the 100 valid grasps recorded in 2013; with those above, 26 (decision 15).
REAL_FORCE_SD_N = 0.3  # a hundredth of these recordings' peak force by Eq. (2)
REAL_FORCE_SD_V = 0.025  # the same where newtons are a constant times the strain: a hundredth of its peak
REAL_DISPLACEMENT_SD_M = 50e-6
REAL_DYNAMIC_SHARE = 0.5
REAL_DRIFT_RATE = 10.0  # share of the force squared, per second: the tissue leaves its curve by 30 % in 10 ms

# A lenient filter learns parameters only while the force rises: afterwards it would take relaxation for damping.
RISE_SPAN_SAMPLES, RISE_MEAN_SAMPLES = 40, 5  # mean of the last five samples against the mean of five, 40 ms before
MIN_RISE_N = 0.02  # two standard deviations of such a difference at 2 mV
MIN_RISE_SHARE = 0.03  # share of the force: less may be noise of a worse strain gage
JAW_OPENING_SHARE = 0.2  # share of the largest force below which the return spring opens the jaws
MIN_PEAK_BEFORE_OPENING_N = 0.2  # a grasp with a smaller peak cannot be opening yet
EMPTY_JAWS_TRAVEL_M = 0.1e-3  # jaws that close within this travel after contact are empty

# --- health of a filter -----------------------------------------------------------------------------------------------
MAX_LOG_DEVIATION = 7.0  # a parameter further than a factor 1,100 from its guess has run away
EXPONENT_LIMIT = 50.0  # beta x beyond which a filter has diverged; exp(50) is beyond any tissue
NIS_INFLATION_THRESHOLD = 16.0  # four standard deviations: the linearization misled the filter, so P is inflated
MAX_INFLATION = 4.0  # times the covariance, in one sample
NIS_MEMORY = 0.95  # of the running mean of the normalized innovation squared: 20 samples
NIS_DIVERGED = 50.0
# The elastic force of a filter that follows the grasp is below the measured force while the jaws close. A filter whose
# elastic force exceeds this multiple of the grasp's peak so far, and this margin for its beginning, has diverged.
DIVERGED_FORCE_RATIO, DIVERGED_FORCE_N = 2.0, 0.5

# --- second passes ----------------------------------------------------------------------------------------------------
# After these numbers of samples, each filter processes the grasp again, linearized at its present estimate (decision
# 9). Together the passes cost half as much as the samples; the last one takes two milliseconds.
SECOND_PASS_AT = (16, 64, 256, 1024)
# Tissue as soft as living tissue is still curving after 64 samples. So the strict filters, which carry the evidence
# where Eq. (7) holds, have one more pass with libraries that state their units. Others keep the passes that they were
# judged with.
STRICT_SECOND_PASS_AT = (16, 64, 128, 224, 1024)

# --- evidence ---------------------------------------------------------------------------------------------------------
# SD of log alpha, beta, d beyond the specimens' spread: no tissue follows Eq. (7) exactly, and other motion looks like
# damping.
MODEL_ERROR_LOG_SD = np.array([0.05, 0.02, 0.3])
# SD of log alpha, beta, d of grasps on one spot about the spot's own: part of the spread of specimens.
GRASP_SCATTER_LOG_SD = np.array([0.03, 0.01, 0.05])
# Mean normalized innovation squared up to which the model fits; beyond it the data's information is scaled down.
NIS_TOLERANCE = 1.3
SURPRISE_MIN_SAMPLES = 20  # samples after contact before the best filter's running misfit is meaningful
SURPRISE_TOLERANCE = 2.0  # tissues that differ from Eq. (7) reach 1.4 to 1.8; the rest is a margin for friction
SURPRISE_EFFECTIVE_SAMPLES = 39  # independent samples in a running mean with NIS_MEMORY: (1 + 0.95) / (1 - 0.95)
FOLD_PROBABILITY = 0.02  # share of grasps on an edge or a fold, whose thickness at contact is no evidence
FILLED_JAWS_MARGIN_M = 1e-3  # tissue met within this travel may be thicker than the jaws open
UNKNOWN_THICKNESS_M = 0.009  # thickness of things outside the library,
UNKNOWN_LOG_THICKNESS_SD = 1.0  # within a factor of 2.7 either way
