"""A simulated grasper behind a simulated NI board, driven through the real nidaqmx package."""
