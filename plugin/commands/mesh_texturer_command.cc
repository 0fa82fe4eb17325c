#include "plugin/commands/mesh_texturer_command.h"

#include <fmt/format.h>

#include <filesystem>
#include <ostream>
#include <string>

#include "plugin/outputs/texture_workspace.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/require_writable.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

void Print(const TextureWorkspaceSummary& summary, std::ostream& out) {
  const TextureSummary& texture = summary.texture;
  std::string pages;
  for (const ImageSize& page : summary.pages) {
    pages += fmt::format("{}{} x {}", pages.empty() ? "" : ", ", page.width, page.height);
  }
  out << fmt::format("photos           {}, {} with masks; {:.1f} for each texel\n", summary.num_photos,
                     summary.num_masks, texture.mean_photos)
      << fmt::format("texel            {:.4g}, {:.2f} pixels of the photos\n", texture.texel_size,
                     texture.texel_pixels)
      << fmt::format("texels           {}, {:.1f} % of them seen, in {} charts\n", texture.num_texels,
                     100.0 * static_cast<double>(texture.num_seen) / static_cast<double>(texture.num_texels),
                     texture.num_charts)
      << fmt::format("pages            {}, {:.0f} % of them used\n", pages, 100 * texture.page_use)
      << fmt::format("exposure         differs by {:.1f} % from photo to photo\n", 100 * texture.gain_spread);
  if (texture.error_even > 0) {
    out << fmt::format(
        "light            smoothed photos left out differ by {:.2f} grey values, by {:.2f} under the "
        "light that stands still\n",
        texture.error_even, texture.error_lit);
  }
  if (summary.held_out.num_photos > 0) {
    out << fmt::format(
        "held out         {} photos: {:.2f} dB on the object, {:.2f} under its light; {:.1f} % of it "
        "covered\n",
        summary.held_out.num_photos, summary.held_out.psnr, summary.held_out.psnr_lit,
        100 * summary.held_out.covered_share);
  }
  for (const fs::path& path : summary.written) out << "written          " << path.string() << '\n';
}

void AddTextureOptions(Options* options, TextureWorkspaceOptions* texturer) {
  options->Add("output_path", &texturer->output_path,
               "the files' names without extension; empty: dense/0/textured-tsdf");
  options->Add("mesh_path", &texturer->mesh_path,
               "the mesh, .ply, in the frame of dense/0/sparse; empty: dense/0/meshed-tsdf.ply");
  options->Add("mask_path", &texturer->mask_path,
               "masks NAME.png for the images of dense/0; empty: dense/0/masks, else masks where the photos "
               "are free of distortion");
  options->Add("render_path", &texturer->render_path,
               "folder for pictures of the textured mesh in the views of the photos that test_every holds "
               "out, lit as it is there; empty: none");
  auto own = options->Fields(texturer);
  own.Add("test_every", &TextureWorkspaceOptions::test_every,
          "take no texture from every n-th photo by name, and compare the textured mesh with it; 0: none");
  auto texture =
      options->Group("Texture", &texturer->texture, "size of texels and pages, and how photos are compared");
  texture.Add("texel_size", &TextureOptions::texel_size, "edge of a texel; 0: from the photos' resolution")
      .Unit("as the poses");
  texture
      .Add("texel_size_pixels", &TextureOptions::texel_size_pixels,
           "edge of a texel where it is chosen, in pixels of the photo that shows a place best")
      .Unit("px");
  texture.Add("max_page_size", &TextureOptions::max_page_size, "longest side of a page of the texture")
      .Unit("px");
  texture.Add("gutter", &TextureOptions::gutter, "texels around each chart that continue its colours")
      .Unit("px");
  texture.Add("equalise", &TextureOptions::equalise,
              "take out what exposure and white balance changed from photo to photo");
  texture.Add(
      "unshade", &TextureOptions::unshade,
      "compare photos without the light that stands still while the table turns; with 0, as they are");
  texture
      .Add("max_memory_gib", &TextureOptions::max_memory_gib,
           "work in portions that fit, with larger texels where the pages do not")
      .Unit("GiB");
  texture.Add("num_threads", &TextureOptions::num_threads, "0: one for each core");
}

}  // namespace

void RunMeshTexturer(CommandContext& context) {
  fs::path workspace_path;
  TextureWorkspaceOptions texturer;
  Options& options = context.Declare(
      "Gives the mesh of dense/0 the colours of the photos: dense/0/textured-tsdf.obj (with .mtl), .glb (one "
      "file) and .ply, with their texture's pages textured-tsdf_0.png and so on. Each texel is blended from "
      "the photos that show its place best: large, sharp, without gloss, and with nothing in front. Light "
      "that stands still while the table turns, and the shadows that the object casts on itself, are found "
      "from the photos, which are compared without it; the colours are the mean of what photos show. Skipped "
      "when it is done; with --output_path it always runs.",
      "--workspace_path scan --Texture.texel_size_pixels 0.5");
  options.Add("workspace_path", &workspace_path, "the workspace, with dense/0").Required();
  AddTextureOptions(&options, &texturer);
  Reporter& reporter = context.Parse();

  const Workspace workspace{workspace_path};
  const auto run = [&] { Print(TextureWorkspace(workspace, texturer, reporter), context.out()); };
  StageRunner runner(workspace, reporter);
  if (!texturer.output_path.empty()) {  // no part of the workspace: always written
    RequireWritable(texturer.output_path.string() + ".obj");
    return run();
  }
  // Pictures are drawn of a texture while it is made.
  if (!texturer.render_path.empty()) RemoveStageStamp(workspace, "mesh_texturer");
  Stage stage;
  stage.name = "mesh_texturer";
  stage.inputs = {texturer.mesh_path.empty() ? workspace.TsdfMesh() : texturer.mesh_path,
                  workspace.DenseModel(), workspace.DenseImages(), workspace.DenseMasks(),
                  workspace.Turntable()};
  for (const fs::path& masks : {texturer.mask_path, workspace.Masks()}) {
    if (!masks.empty()) stage.inputs.push_back(masks);
  }
  stage.options = ValuesWithout(options, {"workspace_path", "output_path", "mask_path", "mesh_path",
                                          "render_path", "Texture.num_threads"});
  stage.outputs = workspace.TexturedMeshFiles();
  stage.depends_on = {"tsdf_mesher"};
  if (!runner.Run(stage, run)) {
    context.out() << "up to date       " << workspace.TexturedMesh().string() << ".glb\n";
  }
}

}  // namespace s2gs
