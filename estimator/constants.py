"""Every constant of the estimation itself, with its reason. What a user may change stands in `graspwatch.toml`.

The paper leaves P0, Qw, R and the initial guesses unstated; here they are. None was fitted to a seed: each follows from
the sensor chain, or was chosen on simulated grasps whose seeds the studies do not use (decisions 2, 3 and 8 to 10).
"""

import numpy as np

# --- where a grasp starts ---------------------------------------------------------------------------------------------
PRIOR_SD_FACTOR = 2.0  # a filter's prior is wider than its tissue's spread, so that it can follow its neighbours' data
INITIAL_COMPRESSION_M = (
    28e-6  # a touch is told a sample (up to 30 µm) late, and touch sensors need some pressure themselves:
)
INITIAL_COMPRESSION_SD_M = 38e-6  # up to 0.1 mm of it can then be found from the data
VELOCITY_SD_M_PER_S = 0.05  # the jaws arrive at about 30 mm/s
UNDETECTED_FORCE_N = 0.005  # scale of what presses before the back-dated rise of the force begins; see decision 4

# --- noise ------------------------------------------------------------------------------------------------------------
FORCE_NOISE_SD_N = 0.001  # what the strain gage does not see: motion of the tissue, roughness of the drive
DISPLACEMENT_NOISE_SD_M = 0.5e-6  # rounding to an encoder count of about 1 µm at the jaws, with a margin
LOG_WALK_SD = np.array([1e-4, 1e-4, 5e-4])  # a sample: log alpha, beta, d drift slowly under load
REST_SAMPLES = 400  # before a grasp, from which the strain noise is measured: good to 6 %
MIN_REST_SAMPLES = 100  # fewer say too little: what the tool file says holds
REST_SETTLING_SAMPLES = 100  # samples after a grasp in which the jaws still open
REST_VARIANCE_RANGE = (0.1, 100.0)  # of the tool file's variance, within which the measured one is believed

# --- trust in the model: each tissue has a filter of either kind, and the data say which is right (decision 8) --------
STRICT_LOG_MASS_SD = 0.05  # as good as known
STRICT_DYNAMIC_SHARE = 0.2  # damping and inertial force may be wrong by this share, sample by sample
LENIENT_LOG_MASS_SD = 0.8  # how much moves depends on how much is held: 5 g times or by a factor 2.2
LENIENT_DYNAMIC_SHARE = 0.3  # damping may grow with the force (Hunt-Crossley), friction may act
LENIENT_DRIFT_RATE = 0.03  # of the force squared, a second: the tissue leaves its curve by 5 % in 0.1 s (it relaxes,
DRIFT_FLOOR_N = 0.05  # the body moves it, it slides), and by as much of this where there is hardly a force

# Of real tissue with a learned library: no alpha and beta are right over a whole loading, and cable and drive rub.
# With these, filters follow 98 of the 100 sound grasps recorded in 2013; with those above, 26 (decision 15).
REAL_FORCE_SD_N = 0.3  # a hundredth of the peak that these recordings' calibration gives
REAL_DISPLACEMENT_SD_M = 50e-6
REAL_DYNAMIC_SHARE = 0.5
REAL_DRIFT_RATE = 10.0  # of the force squared, a second: the tissue leaves its curve by 30 % in 10 ms

# A lenient filter learns parameters only while the force rises: afterwards it would take relaxation for damping.
RISE_SPAN_SAMPLES, RISE_MEAN_SAMPLES = 40, 5  # samples: the mean of the last five against that of five, 40 ms before
MIN_RISE_N = 0.02  # two standard deviations of such a difference at 2 mV
MIN_RISE_SHARE = 0.03  # of the force: noise of a worse strain gage is no rise
JAW_OPENING_SHARE = 0.2  # of the largest force: the jaws open, the return spring moves them and not the tissue
MIN_PEAK_BEFORE_OPENING_N = 0.2  # a smaller force is not yet a grasp that can be over
EMPTY_JAWS_TRAVEL_M = 0.1e-3  # jaws that are shut after less travel than this from contact hold nothing

# --- health of a filter -----------------------------------------------------------------------------------------------
MAX_LOG_DEVIATION = 7.0  # a parameter further than a factor 1,100 from its guess has run away
EXPONENT_LIMIT = 50.0  # beta x beyond which a filter has diverged; exp(50) is beyond any tissue
NIS_INFLATION_THRESHOLD = (
    16.0  # four standard deviations: the linearisation has misled the filter, so it gets less sure
)
MAX_INFLATION = 4.0  # times the covariance, in one sample
NIS_MEMORY = 0.95  # of the running mean of the normalised innovation squared: 20 samples
NIS_DIVERGED = 50.0

# --- second passes ----------------------------------------------------------------------------------------------------
# After so many samples of a grasp, each filter goes over all of them again, linearised at what it has learned since
# (decision 9). Together the passes cost half as much as the samples; the last of them takes two milliseconds.
SECOND_PASS_AT = np.array([16, 64, 256, 1024])

# --- evidence ---------------------------------------------------------------------------------------------------------
MODEL_ERROR_LOG_SD = np.array([0.05, 0.02, 0.3])  # of log alpha, beta, d beyond the specimens' spread: no tissue is
# exactly Eq. (7), and what is taken for its damping depends most on what else moves
NIS_TOLERANCE = 1.3  # mean normalised innovation squared up to which the model counts as fitting; beyond, the data
# are believed less in proportion
SURPRISE_MIN_SAMPLES = 20  # samples after contact before the best filter's running misfit means anything
SURPRISE_TOLERANCE = 2.0  # tissues give rise to 1.4 to 1.8, whatever Eq. (7) misses of them, with a margin for friction
SURPRISE_EFFECTIVE_SAMPLES = 39  # that a running mean with this memory is worth: (1 + 0.95) / (1 - 0.95)
FOLD_PROBABILITY = 0.02  # of grasps in which the thickness at contact says nothing: an edge or a fold was taken
FILLED_JAWS_MARGIN_M = 1e-3  # tissue met within this travel may be thicker than the jaws open
UNKNOWN_THICKNESS_M = 0.009  # of things outside the library, with
UNKNOWN_LOG_THICKNESS_SD = 1.0  # a factor 2.7 either way
