const HEAD = (name: string, title: string): string => `name = "${name}"            # small letters, digits, underscores
title = "${title}"
cycles = 3                  # grasps

[waveform]
`;

/** Texts to begin a protocol with, by the shape of their motion. */
export const TEMPLATES = {
  steps: `${HEAD("my_steps", "My steps")}shape = "custom"            # straight lines between these points
time_s = [0.0, 0.25, 1.0, 1.25, 2.0, 2.25]
command_v = [0.0, 0.5, 0.5, 1.0, 1.0, 0.0]   # begins and ends at 0
rest_s = 1.0
`,
  trapezoid: `${HEAD("my_trapezoid", "My trapezoid")}shape = "trapezoid"
peak_v = 1.0
ramp_up_s = 0.25
hold_s = 1.0
ramp_down_s = 0.25
rest_s = 0.5
`,
  sine: `${HEAD("my_sine", "My sine")}shape = "sine"              # one slow cycle, then fast ones
peak_n = 1.0                # at the jaws
first_hz = 0.5
then_hz = 2.0
then_cycles = 2
rest_s = 0.5
`,
};
