#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "sfm_split/pictures/tile_motion.h"

namespace s2gs {

/// A photo in shades of grey, reduced to a few hundred pixels: enough to tell whether the camera moved by a
/// pixel of the photo, and what changed in front of it.
struct GreyPicture {
  Eigen::Vector2i photo_size = Eigen::Vector2i::Zero();  ///< width and height of the photo [px].
  int width = 0;                                         ///< of the picture [px].
  int height = 0;
  std::vector<uint8_t> grey;  ///< height * width, from top to bottom.

  /// The photo's pixels per pixel of the picture. Both count from the corner: x_photo = scale * x_picture.
  Eigen::Vector2d Scale() const {
    return photo_size.cast<double>().cwiseQuotient(Eigen::Vector2d(width, height));
  }
};

/// The longest side of pictures that CompareWith() is meant for [px]. At 480 a textured tile is placed to
/// .03 px, which is less than a tenth of a pixel of a photo of 1280.
constexpr int kPictureSidePx = 480;

/// PictureComparison::log_chance of what is no accident: one in a million.
constexpr double kMaxLogChance = -14;

/// A picture of the size that a photo is reduced to, without its pixels.
GreyPicture PictureFor(const Eigen::Vector2i& photo_size);

/// Two pictures of a camera that may have stood still.
struct PictureComparison {
  enum class Verdict { kStill, kMoved, kUnknown };
  Verdict verdict = Verdict::kUnknown;  ///< kUnknown: too little texture to tell.
  std::vector<TileMatch> tiles;         ///< of the first picture, row by row.
  int num_textured = 0;                 ///< without edges.
  int num_agreeing = 0;                 ///< without edges.
  int num_edges = 0;                    ///< that were asked.
  int num_cells = 0;                    ///< of an 8 x 8 grid over the picture that agreeing tiles lie in.
  double log_chance = 0;                ///< logarithm of how likely chance makes as many agree.
  /// Where the second picture shows a pixel of the first one's background: shake of the tripod. The simplest
  /// that explains the tiles, as FitTileMotion or FitCameraTurn finds it. [px of the pictures]
  Eigen::Matrix3d second_from_first = Eigen::Matrix3d::Identity();
};

/// A picture that others are compared with, tile by tile, by the correlation of gradients, which exposure and
/// white balance leave alone. What an unrelated tile reaches at its best shift is the threshold that a tile
/// must pass, so that noise and compression set their own bounds. Tiles that changed (the object, a hand, a
/// person) do not matter as long as the agreeing ones spread over the picture. Before a plain background
/// edges are what stays: each tells its place across itself, and enough of them in all directions tell the
/// camera's.
class PictureStandard {
 public:
  /// \param max_shake_px    largest shift that shake explains [px of the photo].
  /// \param min_share       of the textured tiles that must agree.
  /// \param min_cells       of the 8 x 8 grid that they must lie in.
  /// \param to_border       its tiles reach as near to the border as a search allows, where a rim may be all
  /// that stays.
  PictureStandard(const GreyPicture& picture, double max_shake_px, double min_share, int min_cells,
                  bool to_border = false);

  /// Pictures of another size are kMoved.
  /// \param is_passing  per tile: whether other pictures show that it does not stay, so that it is not asked;
  ///                    empty: nothing is known.
  PictureComparison CompareWith(const GreyPicture& other, const std::vector<char>& is_passing = {}) const;

 private:
  using Array = Eigen::Array<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  // Gradients of the picture at one size.
  struct Level {
    Array gx;
    Array gy;
    double noise = 0;  // standard deviation of the grey values
  };
  struct Tile {
    int x = 0;  // top left pixel
    int y = 0;
    double least_texture = 0;                           // smaller eigenvalue of the structure tensor
    double most_texture = 0;                            // larger one
    Eigen::Vector2d normal = Eigen::Vector2d::UnitX();  // its direction
    double energy = 0;
    bool is_unique = false;  // does not look the same within reach of a search
    bool is_edge = false;    // is textured across one direction alone, and looks the same nowhere along it
    double own_place = 0;    // of an edge: of its correlation with itself, along the normal [px]
    Eigen::Vector2d
        own_summit;  // of its correlation with itself, off the centre where its slopes differ [px]

    // Standard deviation of its place along the direction of least texture, that the other's error leaks.
    double LeakPx() const;
  };

  static Level MakeLevel(const GreyPicture& picture, int factor);
  static std::vector<Tile> MakeTiles(const Level& level, int side, int margin);
  // Correlations at all shifts of up to `radius` from a place, row by row; false where that leaves the
  // picture.
  static bool Correlate(const Level& first, const Tile& tile, const Level& second,
                        const Eigen::Vector2i& place, int side, int radius, std::vector<double>* surface);
  void FindUniqueTiles();
  void FindEdges();
  Eigen::Vector2i CoarseShift(const Level& other) const;
  double NullCorrelation(const Level& other, const Eigen::Vector2i& shift) const;
  void MatchTiles(const Level& other, const Eigen::Vector2i& shift, const std::vector<char>& is_passing,
                  double least_correlation, PictureComparison* comparison) const;
  void MatchEdges(const Level& other, const Eigen::Vector2i& shift, PictureComparison* comparison) const;
  bool StandsStillByTiles(PictureComparison* comparison) const;
  bool StandsStillByEdges(const Level& other, const Eigen::Vector2i& shift,
                          PictureComparison* comparison) const;
  PictureComparison CompareAt(const Level& other, const Eigen::Vector2i& shift,
                              const std::vector<char>& is_passing) const;

  int width_;
  int height_;
  double max_shake_px_;  // of the picture
  double min_share_;
  int min_cells_;
  Level fine_;
  Level coarse_;
  std::vector<Tile> tiles_;
  std::vector<Tile> coarse_tiles_;
};

}  // namespace s2gs
