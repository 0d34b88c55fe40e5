/** Returns a generator of whole numbers from `low` to `high`, the same ones for the same seed. */
export function integers(seed: number): (low: number, high: number) => number {
  let state = seed;
  return (low, high) => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0; // linear congruential, constants of Numerical Recipes
    return low + Math.floor((state / 2 ** 32) * (high - low + 1));
  };
}

/** The seeds that a property is tried with. */
export const SEEDS = Array.from({ length: 50 }, (_, i) => i + 1);
