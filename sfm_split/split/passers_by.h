#pragma once

#include <vector>

#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"

namespace s2gs {

/// Who walks by in front of a camera moves from photo to photo as the table does, and may do so more plainly.
/// The table turns in most photos; who walks by shows in some. That is asked twice: a place where most photos
/// of a station change is the table's, and what moves beside such places, like marks on a plain sheet that
/// pass each place now and then, is so as well where it moves in most photos of the station.
class PassersBy {
 public:
  /// \param pictures  nullptr where nothing is known of places: then nobody walks by.
  PassersBy(const ScanPictures* pictures, SplitMatching* matching, const Stations* stations);

  /// Notes the photos of pairs, of photos of one station, in which matches beside the table's places follow a
  /// motion that is no accident.
  /// \param moving  per pair: the matches that do not follow the background.
  void Look(const std::vector<ImagePairMatches>& pairs, const std::vector<std::vector<int>>& moving);
  /// Takes out of a pair of photos in both of which somebody walks by the matches neither end of which lies
  /// at a place of the table. \return  whether there were any.
  bool LeaveOut(ImagePairMatches* pair) const;

 private:
  // Somebody does in this photo, as far as pairs that were looked at tell.
  bool WalksBy(int image) const;
  bool IsBeside(const ImagePairMatches& pair, const FeatureMatch& match) const;

  const ScanPictures* pictures_;
  SplitMatching& matching_;
  const Stations& stations_;
  std::vector<bool> moves_beside_;      // per photo
  std::vector<int> num_moving_beside_;  // per station: of its photos
};

}  // namespace s2gs
