#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

/// What a texel of a page is.
constexpr uint8_t kBlankTexel = 0;   ///< no surface.
constexpr uint8_t kUnseenTexel = 1;  ///< surface without a colour yet.
constexpr uint8_t kSeenTexel = 2;    ///< with its colour.

/// Continues the colours around charts by so many texels, each the mean of its neighbours that have one: what
/// bilinear filters and smaller copies of a page reach must not be blank. What is left is the mean of the
/// page, so that much smaller copies keep the colours, too. \param states  of the page's texels.
void FillGutters(int gutter, std::vector<uint8_t>* states, Image8* page);

/// Colours for all vertices from those that have some: sums of colours and their weight. The others get the
/// mean of their neighbours, those next to known ones first; parts of the mesh without any get the mean of
/// all.
std::vector<Eigen::Array3f> SpreadVertexColors(const TriangleMesh& mesh,
                                               const std::vector<Eigen::Array4f>& sums);

}  // namespace s2gs
