#pragma once

#include <cstdint>
#include <vector>

#include "sfm_split/split/change_maps.h"
#include "sfm_split/split/picture_comparison.h"
#include "sfm_split/split/station_pictures.h"

namespace s2gs {

/// The order in which the table took one station's photos, by their pictures alone: what changes differs
/// least between photos next to each other, so that the order is the shortest closed way through all of them.
/// It asks for no features. Where it begins, and its sense, are arbitrary; photo 0 comes first. The order
/// given is kept where its way is shorter than chance explains: names often tell it, and what looks alike
/// from several sides misleads pictures. \param photos     of one size, in the order given. \param is_active
/// per pixel of the pictures: where they change. \return  empty when the pictures cannot tell.
std::vector<uint32_t> OrderByPictures(const std::vector<const GreyPicture*>& photos,
                                      const std::vector<uint8_t>& is_active);

/// All photos, station by station, each as the table took it. Empty where the order given is that of every
/// station that tells one.
std::vector<uint32_t> OrderOfCapture(const std::vector<GreyPicture>& photos, const PictureStations& stations,
                                     const SceneChanges& changes);

}  // namespace s2gs
