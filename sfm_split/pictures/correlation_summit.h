#pragma once

#include <Eigen/Core>
#include <vector>

namespace s2gs {

// Where a correlation is largest, of values at all shifts of up to `radius`, row by row.

/// The summit of a paraboloid through the 3 x 3 correlations around the largest; false at the search's border
/// and on ridges. \param curvature  at the summit, along the flatter axis [1/px^2]. \param at         from
/// the search's centre [px].
bool Summit(const std::vector<double>& surface, int radius, double* correlation, double* curvature,
            Eigen::Vector2d* at);

/// The largest correlation along `normal` from the search's centre, and its place there, by a paraboloid
/// through the 3 x 3 correlations around it; false at the search's border.
/// \param curvature  there, along the normal [1/px^2].
/// \param at         from the search's centre, along the normal [px].
bool SummitAlong(const std::vector<double>& surface, int radius, const Eigen::Vector2d& normal,
                 double* correlation, double* curvature, double* at);

}  // namespace s2gs
