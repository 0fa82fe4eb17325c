#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

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

/// A picture of the size that a photo is reduced to, without its pixels.
GreyPicture PictureFor(const Eigen::Vector2i& photo_size);

/// What one tile of a picture does from there to another picture of the scene.
struct TileMatch {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();  ///< [px of the picture, from its corner]
  bool is_textured = false;      ///< in both directions, so that noise moves it by no more than .1 px, and
                                 ///< not alike a few pixels beside, as a checked cloth is.
  bool is_found = false;         ///< its gradients correlate better than those of unrelated tiles do.
  bool agrees = false;           ///< and it lies where the camera's own motion puts it.
  double correlation = 0;        ///< of the gradients, 1: equal but for contrast.
  double sigma_px = 0;           ///< standard deviation of the displacement.
  Eigen::Vector2d displacement;  ///< [px of the picture]
};

/// Two pictures of a camera that may have stood still.
struct PictureComparison {
  enum class Verdict { kStill, kMoved, kUnknown };
  Verdict verdict = Verdict::kUnknown;  ///< kUnknown: too little texture to tell.
  std::vector<TileMatch> tiles;         ///< of the first picture, row by row.
  int num_textured = 0;
  int num_agreeing = 0;
  int num_cells = 0;  ///< of an 8 x 8 grid over the picture that agreeing tiles lie in.
  /// Where the second picture shows a pixel of the first one's background: shake of the tripod. The simplest
  /// that explains the tiles: the identity, a shift, an affine map or a homography. [px of the pictures]
  Eigen::Matrix3d second_from_first = Eigen::Matrix3d::Identity();
};

/// A picture that others are compared with, tile by tile, by the correlation of gradients, which exposure and
/// white balance leave alone. What an unrelated tile reaches at its best shift is the threshold that a tile
/// must pass, so that noise and compression set their own bounds. Tiles that changed (the object, a hand, a
/// person) do not matter as long as the agreeing ones spread over the picture.
class PictureStandard {
 public:
  /// \param max_shake_px    largest shift that shake explains [px of the photo].
  /// \param min_share       of the textured tiles that must agree.
  /// \param min_cells       of the 8 x 8 grid that they must lie in.
  PictureStandard(const GreyPicture& picture, double max_shake_px, double min_share, int min_cells);

  /// Pictures of another size are kMoved.
  PictureComparison CompareWith(const GreyPicture& other) const;

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
    double least_texture = 0;  // smaller eigenvalue of the structure tensor
    double energy = 0;
    bool is_unique = false;  // does not look the same within reach of a search
    Eigen::Vector2d
        own_summit;  // of its correlation with itself, off the centre where its slopes differ [px]
  };

  static Level MakeLevel(const GreyPicture& picture, int factor);
  static std::vector<Tile> MakeTiles(const Level& level, int side);
  // Correlations at all shifts of up to `radius` from a place, row by row; false where that leaves the
  // picture.
  static bool Correlate(const Level& first, const Tile& tile, const Level& second,
                        const Eigen::Vector2i& place, int side, int radius, std::vector<double>* surface);
  void FindUniqueTiles();
  Eigen::Vector2i CoarseShift(const Level& other) const;
  double NullCorrelation(const Level& other, const Eigen::Vector2i& shift) const;
  void MatchTiles(const Level& other, const Eigen::Vector2i& shift, double least_correlation,
                  PictureComparison* comparison) const;
  void FitMotion(PictureComparison* comparison) const;
  PictureComparison CompareAt(const Level& other, const Eigen::Vector2i& shift) const;

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
