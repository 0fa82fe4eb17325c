#pragma once

#include <cstdint>
#include <vector>

#include "sfm_split/pictures/picture_comparison.h"
#include "sfm_split/split/change_maps.h"
#include "sfm_split/split/station_pictures.h"

namespace s2gs {

/// The photos in an order that what they show alone decides (by their pixels, in no meaningful way): what is
/// computed from photos in this order is the same under all names.
std::vector<uint32_t> OrderByContent(const std::vector<GreyPicture>& photos);

/// The order in which the table took one station's photos, by their pictures alone: what changes differs
/// least between photos next to each other, so that the order is the shortest closed way through all of them.
/// It asks for no features. It begins after the way's longest step, which is the gap where the turn is not a
/// full one, at that end of the step whose other neighbour is nearer. The order of names is kept where its
/// way is shorter than chance explains: names often tell it, and what looks alike from several sides misleads
/// pictures. \param photos     of one size. \param is_active  per pixel of the pictures: where they change.
/// \param by_name  the photos in the order of their names. \return  empty when the pictures cannot tell.
std::vector<uint32_t> OrderByPictures(const std::vector<const GreyPicture*>& photos,
                                      const std::vector<uint8_t>& is_active,
                                      const std::vector<uint32_t>& by_name);

/// All photos, station by station, each as the table took it. Stations whose pictures cannot tell it are in
/// the order of names. \param place_by_name  of each photo. \return  empty where the order of names is that
/// of every station that tells one.
std::vector<uint32_t> OrderOfCapture(const std::vector<GreyPicture>& photos, const PictureStations& stations,
                                     const SceneChanges& changes, const std::vector<uint32_t>& place_by_name);

}  // namespace s2gs
