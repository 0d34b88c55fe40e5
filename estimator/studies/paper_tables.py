"""The paper's tables as printed, in the order liver, small bowel, bladder, gallbladder."""

TISSUES = ("liver", "small_bowel", "bladder", "gallbladder")
TABLE_3 = {
    "alpha": (799.9094, 489.3628, 0.0046, 356.6571),
    "beta": (14.5509, 12.0474, 20.5933, 11.4143),
    "d": (4.7069, 5.014, 2.489, 1.3985),
}
TABLE_4_S = (0.379, 0.354, 0.282, 0.369)
TABLE_4_N = (0.014, 0.010, 0.010, 0.013)
TABLE_5_S = (
    (0.366, 0.384, 1.217, 6.807),
    (0.339, 0.359, 1.047, 4.621),
    (8.220, 8.220, 0.274, 2.470),
    (9.061, 9.032, 1.429, 0.371),
)
# In vivo, 271, 155, 173 and 112 grasps: convergence time s and force error N, each as max, mean, min
TABLE_6_S = ((0.727, 0.257, 0.029), (0.768, 0.292, 0.029), (2.419, 0.309, 0.033), (0.714, 0.253, 0.073))
TABLE_6_N = ((0.679, -0.273, -5.304), (0.470, -0.276, -1.953), (0.965, 0.175, -0.922), (0.668, -0.177, -9.325))
# Means in vivo: alpha in mN except for the bladder, beta per unit strain, as in Table II.
TABLE_7 = {
    "alpha": (757.808, 459.157, 0.004, 336.186),
    "beta": (5.758, 4.321, 16.956, 6.411),
    "d": (2.841, 3.004, 1.213, 0.455),
}
