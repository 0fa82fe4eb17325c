#pragma once

#include <Eigen/Core>
#include <filesystem>
#include <istream>
#include <map>
#include <optional>
#include <ostream>
#include <string>

#include "sfm_split/scene/io/colmap_model.h"

// The two encodings behind colmap_model.h. Each item is checked by the functions below where its reader can
// still say at which byte or line it stands.

namespace s2gs::colmap_binary {

std::map<uint32_t, Camera> ReadCameras(std::istream& stream, const std::filesystem::path& path);
std::map<uint32_t, ColmapImage> ReadImages(std::istream& stream, const std::filesystem::path& path);
std::map<uint64_t, ColmapPoint3D> ReadPoints3D(std::istream& stream, const std::filesystem::path& path);
std::map<uint32_t, ColmapRig> ReadRigs(std::istream& stream, const std::filesystem::path& path);
std::map<uint32_t, ColmapFrame> ReadFrames(std::istream& stream, const std::filesystem::path& path);

void Write(std::ostream& stream, const std::map<uint32_t, Camera>& cameras);
void Write(std::ostream& stream, const std::map<uint32_t, ColmapImage>& images);
void Write(std::ostream& stream, const std::map<uint64_t, ColmapPoint3D>& points3D);
void Write(std::ostream& stream, const std::map<uint32_t, ColmapRig>& rigs);
void Write(std::ostream& stream, const std::map<uint32_t, ColmapFrame>& frames);

}  // namespace s2gs::colmap_binary

namespace s2gs::colmap_text {

std::map<uint32_t, Camera> ReadCameras(std::istream& stream, const std::filesystem::path& path);
std::map<uint32_t, ColmapImage> ReadImages(std::istream& stream, const std::filesystem::path& path);
std::map<uint64_t, ColmapPoint3D> ReadPoints3D(std::istream& stream, const std::filesystem::path& path);
std::map<uint32_t, ColmapRig> ReadRigs(std::istream& stream, const std::filesystem::path& path);
std::map<uint32_t, ColmapFrame> ReadFrames(std::istream& stream, const std::filesystem::path& path);

void Write(std::ostream& stream, const std::map<uint32_t, Camera>& cameras);
void Write(std::ostream& stream, const std::map<uint32_t, ColmapImage>& images);
void Write(std::ostream& stream, const std::map<uint64_t, ColmapPoint3D>& points3D);
void Write(std::ostream& stream, const std::map<uint32_t, ColmapRig>& rigs);
void Write(std::ostream& stream, const std::map<uint32_t, ColmapFrame>& frames);

}  // namespace s2gs::colmap_text

namespace s2gs {

/// What is wrong with an item on its own, in words that follow the file's name; nothing when it is sound.
std::optional<std::string> FindFault(const Camera& camera);
std::optional<std::string> FindFault(const ColmapImage& image);
std::optional<std::string> FindFault(const ColmapPoint3D& point);
std::optional<std::string> FindFault(const ColmapRig& rig);
std::optional<std::string> FindFault(const ColmapFrame& frame);

/// A pose from a file's numbers. Quaternions that are of unit length but for rounding keep their bits, so
/// that a file survives reading and writing; others are normalised. \param qwxyz_t  qw, qx, qy, qz, tx, ty,
/// tz. \return  nothing when a number is not finite or the quaternion has no direction.
std::optional<Rigid3> PoseFromNumbers(const Eigen::Matrix<double, 7, 1>& qwxyz_t);

/// The inverse: qw, qx, qy, qz, tx, ty, tz.
Eigen::Matrix<double, 7, 1> NumbersFromPose(const Rigid3& pose);

}  // namespace s2gs
