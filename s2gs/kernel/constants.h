#pragma once

namespace s2gs {

/// tau of (8): from this p on, a Gaussian counts as part of the rotating body.
constexpr double kForegroundThreshold = 0.8;

/// Contributions below this alpha are invisible in 8 bits and left out.
constexpr double kMinAlpha = 1.0 / 255;
constexpr double kMaxAlpha = 0.99;
/// Compositing stops before the splat that would bring the transmittance below this.
constexpr double kMinTransmittance = 1e-4;

/// The low-pass filter of 2DGS: a splat is at least a Gaussian of this standard deviation about the
/// projection of its centre. A photo's pixel is the mean over a square of 1 px, whose standard deviation is
/// sqrt(1/12) px. 2DGS takes sqrt(1/2): discs seen edge-on then stand out from silhouettes, and the surface
/// learnt lies deeper (BENCHMARK.md).
constexpr double kLowPassSigma = 0.3;                                            ///< [px]
constexpr double kLowPassInverseVariance = 1 / (kLowPassSigma * kLowPassSigma);  ///< [1/px^2]

/// A disc whose normal is within .057 degrees of a right angle to the ray through its centre is seen edge-on:
/// only its low-pass dot is drawn. Bounds the derivatives by the normal, which grow with 1 / cos^2.
constexpr double kMinCosine = 1e-3;
/// Discs of fewer than 1e-6 px are drawn as their low-pass dot alone; no derivative by their axes.
constexpr double kMaxInverseRadius = 1e6;  ///< [1/px]
/// Splats that project this far outside the image, or lie this far away, are left out.
constexpr double kMaxPixel = 1e7;    ///< [px]
constexpr double kMaxLength = 1e12;  ///< [scene units]
constexpr double kMaxColor = 1e6;

constexpr double kMaxLogScale = 80;  ///< log-scales beyond are culled.

}  // namespace s2gs
