// What a renderer does: render into buffers, hand them over as they lie in memory, get a clean picture back.
//
//   denoise_buffers MODEL [OUTPUT.ppm]      MODEL is a model folder or the name of an installed model
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <fstream>
#include <random>
#include <stdexcept>
#include <string>
#include <vector>

#include <pathfold/pathfold.hpp>

namespace {

constexpr int width = 320, height = 240, samples_per_pixel = 4;

/// A renderer's frame buffer: everything of a pixel side by side. pathfold takes any strides.
struct Pixel {
    float color[3];
    float albedo[3];
    float normal[3];
    float depth;
};

/// A sphere over a floor under a noisy lamp, in place of a renderer.
std::vector<Pixel> render() {
    std::vector<Pixel> frame(size_t(width) * height);
    std::mt19937 random(1);
    std::uniform_real_distribution<float> uniform;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            Pixel &pixel = frame[size_t(y) * width + x];
            const float u = (x - width / 2.0f) / 80, v = (y - height / 2.0f) / 80, square = u * u + v * v;
            const bool sphere = square < 1;
            const float z = sphere ? std::sqrt(1 - square) : 0;
            const float normal[3] = {sphere ? u : 0, sphere ? -v : 1, z};
            const float checker = (x / 20 + y / 20) % 2 ? 0.8f : 0.3f;
            const float light = std::max(0.05f, 0.6f * normal[1] + 0.4f * normal[2]);
            float noise = 0; // a light that few paths find
            for (int i = 0; i < samples_per_pixel; ++i)
                noise += uniform(random) < 0.25f ? 4.0f / samples_per_pixel : 0.0f;
            for (int c = 0; c < 3; ++c) {
                pixel.albedo[c] = sphere ? (c == 0 ? 0.9f : 0.2f) : checker;
                pixel.normal[c] = normal[c];
                pixel.color[c] = pixel.albedo[c] * light * noise;
            }
            pixel.depth = 5 - z;
        }
    return frame;
}

/// A view of one member of every pixel, from the first pixel's on.
pathfold::Image view(const float *first, int channels) {
    pathfold::Image image = pathfold::image(first, height, width, channels);
    image.pixel_stride = sizeof(Pixel);
    image.row_stride = sizeof(Pixel) * width;
    return image;
}

void write_ppm(const std::string &path, const std::vector<float> &pixels) {
    std::ofstream file(path, std::ios::binary);
    file << "P6\n" << width << " " << height << "\n255\n";
    for (float value : pixels)
        file.put(char(std::min(255.0f, 255 * std::pow(value, 1 / 2.2f) + 0.5f)));
    if (!file.flush())
        throw std::runtime_error("cannot write " + path);
}

} // namespace

int main(int count, char **arguments) try {
    if (count < 2) {
        std::fprintf(stderr, "usage: %s MODEL [OUTPUT.ppm]\n", arguments[0]);
        return 2;
    }
    std::vector<Pixel> frame = render();
    std::vector<float> clean(size_t(width) * height * 3);

    const pathfold::Model model(arguments[1]); // once; shared by all threads
    pathfold::Denoiser denoiser(model);        // once per render view
    denoiser.input("color", view(frame[0].color, 3))
        .input("albedo", view(frame[0].albedo, 3))
        .input("normal", view(frame[0].normal, 3))
        .input("depth", view(&frame[0].depth, 1))
        .output("color", pathfold::image(clean.data(), height, width, 3));
    const std::string report = denoiser.run([](float done) {
        std::fprintf(stderr, "\r%3.0f %%", 100 * done);
        return true; // false would cancel
    });
    std::printf("\n%s\n", report.c_str());
    if (count > 2)
        write_ppm(arguments[2], clean);
    return 0;
} catch (const std::exception &error) {
    std::fprintf(stderr, "denoise_buffers: %s\n", error.what());
    return 1;
}
