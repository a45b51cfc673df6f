/**
 * What is shown of polarized light: Stokes components, and what follows from them.
 *
 * `of` takes the values of the components with the numbers `parts`; `range` is that of the result,
 * else it is as large as light is, with a sign.
 */

const LEAST_DEGREE = 0.01; // of linear polarization whose angle is shown

export const STOKES = {
  S0: { name: "S0, intensity", parts: [0], of: (s0) => s0 },
  S1: { name: "S1, 0° − 90°", parts: [1], of: (s1) => s1 },
  S2: { name: "S2, 45° − 135°", parts: [2], of: (s2) => s2 },
  S3: { name: "S3, circular", parts: [3], of: (s3) => s3 },
  degree: {
    ...{ name: "degree of linear polarization", parts: [0, 1, 2], range: [0, 1], unit: "" },
    map: "map distance",
    of: (s0, s1, s2) => (s0 > 0 ? Math.min(1, Math.hypot(s1, s2) / s0) : NaN),
  },
  angle: {
    ...{ name: "angle of linear polarization", parts: [0, 1, 2], range: [0, 180], unit: "°" },
    map: "map phase",
    of: (s0, s1, s2) =>
      Math.hypot(s1, s2) > LEAST_DEGREE * s0 ? ((Math.atan2(s2, s1) * 90) / Math.PI + 180) % 180 : NaN,
  },
};
