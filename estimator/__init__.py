"""From sample blocks to tissue parameters, probabilities and warnings."""
