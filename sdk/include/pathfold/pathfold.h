/* pathfold: a denoiser for Monte Carlo renderings. Plain C99 interface; pathfold.hpp wraps it for C++.
 *
 * A call that can fail returns a pathfold_status; the sentence that explains the failure is
 * pathfold_last_error(), kept per thread. Where a call fails, nothing that it would have returned is set.
 * Strings are UTF-8 and end in a zero byte. */
#ifndef PATHFOLD_H
#define PATHFOLD_H

#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32)
#if defined(PATHFOLD_BUILD)
#define PATHFOLD_API __declspec(dllexport)
#else
#define PATHFOLD_API __declspec(dllimport)
#endif
#define PATHFOLD_MUST_USE
#else
#define PATHFOLD_API __attribute__((visibility("default")))
#define PATHFOLD_MUST_USE __attribute__((warn_unused_result))
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* ---- Version ------------------------------------------------------------------------------------------ */

/* Of this header; pathfold_version() is that of the library. */
#define PATHFOLD_VERSION_MAJOR 0
#define PATHFOLD_VERSION_MINOR 1
#define PATHFOLD_VERSION_PATCH 0

/* Grows with every version: #if PATHFOLD_VERSION >= PATHFOLD_MAKE_VERSION(0, 2, 0) */
#define PATHFOLD_MAKE_VERSION(major, minor, patch) ((major) * 10000 + (minor) * 100 + (patch))
#define PATHFOLD_VERSION                                                                                     \
    PATHFOLD_MAKE_VERSION(PATHFOLD_VERSION_MAJOR, PATHFOLD_VERSION_MINOR, PATHFOLD_VERSION_PATCH)

/* Structs whose first member is `size` grow at their end in later versions. Their function pathfold_..._init
 * sets `size` and everything else to what stands for "chosen". */

/* ---- Status ------------------------------------------------------------------------------------------- */

typedef enum pathfold_status {
    PATHFOLD_OK = 0,
    PATHFOLD_INVALID_ARGUMENT = 1, /* an argument, a buffer or a setting is not what it must be */
    PATHFOLD_NOT_FOUND = 2,        /* no such model, file or library */
    PATHFOLD_INVALID_MODEL = 3,    /* a model folder is damaged, or says of itself what is not so */
    PATHFOLD_ENGINE = 4,           /* the inference library reported a failure */
    PATHFOLD_UNSUPPORTED = 5, /* asked for what this version, model or inference library does not offer */
    PATHFOLD_OUT_OF_MEMORY = 6,
    PATHFOLD_CANCELLED = 7, /* the progress callback returned 0 */
    PATHFOLD_INTERNAL = 8   /* a defect in pathfold */
} pathfold_status;

/* The name of a status in lower case with dashes, "invalid-argument" for example. Never null. */
PATHFOLD_API const char *pathfold_status_name(pathfold_status status);

/* What the last failed call of this thread complains of. Never null; valid until the thread's next call. */
PATHFOLD_API const char *pathfold_last_error(void);

/* The version of this library, "0.1.0" for example. */
PATHFOLD_API const char *pathfold_version(void);

/* ---- Inference library -------------------------------------------------------------------------------- */

/* Names the onnxruntime shared library to load. Without it PATHFOLD_ONNXRUNTIME and then the system's are
 * tried, when the first model is loaded. PATHFOLD_INVALID_ARGUMENT: another one is loaded already.
 * PATHFOLD_NOT_FOUND: there is no such file. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_set_onnxruntime(const char *path);

/* ---- Model -------------------------------------------------------------------------------------------- */

/* A model folder, checked and loaded. Immutable: any number of denoisers and threads may share one. */
typedef struct pathfold_model pathfold_model;

/* Finds the folder of a model by name: an existing folder, else one in PATHFOLD_MODEL_PATH, in `folders`
 * (`folder_count` of them, may be null and 0), or in the models installed with this library. `path` is valid
 * until this thread's next call. PATHFOLD_NOT_FOUND: there is none; the message lists what there is. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_find_model(const char *name,
                                                                   const char *const *folders,
                                                                   size_t folder_count, const char **path);

/* How a model is loaded. */
typedef struct pathfold_model_options {
    size_t size;
    const char *provider;  /* the execution provider, "cpu" (also for null), "cuda", "openvino", ... */
    const char *precision; /* of its networks: "fp32"; "int8", quantised where that costs little, with RelL2
                              at most 1.02 times that of fp32 on views held out of training; or "auto" (also
                              for null): the faster one, which is int8 where the model has it, the provider is
                              "cpu" and the processor multiplies bytes (x86: VNNI; ARM: dot product). What is
                              filtered stays float32 in all of them */
    int32_t threads; /* to use, at most as many as the processors that affinity and control groups leave to
                        this process; 0: that many */
} pathfold_model_options;

static inline pathfold_model_options pathfold_model_options_init(void) {
    pathfold_model_options options;
    options.size = sizeof options;
    options.provider = NULL;
    options.precision = NULL;
    options.threads = 0;
    return options;
}

/* Loads a model by name or folder. `options` null: the defaults.
 * PATHFOLD_INVALID_ARGUMENT: no such precision, or a wrong size of options. PATHFOLD_NOT_FOUND: no such
 * model, or no onnxruntime. PATHFOLD_INVALID_MODEL: it fails a check. PATHFOLD_UNSUPPORTED: the provider is
 * not offered, the model has no int8, or it or `options` needs a newer pathfold. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_model_load(const char *name,
                                                                   const pathfold_model_options *options,
                                                                   pathfold_model **model);

/* Gives a model back; denoisers made from it keep what they need. Null is allowed. */
PATHFOLD_API void pathfold_model_release(pathfold_model *model);

/* The text of the model's manifest.json; lives as long as the model. */
PATHFOLD_API const char *pathfold_model_manifest(const pathfold_model *model);

/* The model's folder; lives as long as the model. */
PATHFOLD_API const char *pathfold_model_folder(const pathfold_model *model);

/* The precision that the model was loaded in, "fp32" or "int8"; the report of a run says it too. */
PATHFOLD_API const char *pathfold_model_precision(const pathfold_model *model);

/* ---- Images ------------------------------------------------------------------------------------------- */

typedef enum pathfold_format { PATHFOLD_FLOAT32 = 0, PATHFOLD_FLOAT16 = 1 } pathfold_format;

/* A view of the caller's pixels, never copied. Strides are in bytes, may be negative, and are taken as they
 * stand, within 2^48 bytes. Pixel images have samples = 1. */
typedef struct pathfold_image {
    void *data;     /* first value of the first pixel; inputs are only read, and may be null until a run */
    int32_t format; /* a pathfold_format */
    int64_t samples, height, width, channels;
    int64_t sample_stride, row_stride, pixel_stride, channel_stride;
} pathfold_image;

/* A view of densely packed pixels: samples x height x width x channels. */
static inline pathfold_image pathfold_packed(void *data, pathfold_format format, int64_t samples,
                                             int64_t height, int64_t width, int64_t channels) {
    int64_t size = format == PATHFOLD_FLOAT16 ? 2 : 4;
    pathfold_image image;
    image.data = data;
    image.format = format;
    image.samples = samples;
    image.height = height;
    image.width = width;
    image.channels = channels;
    image.channel_stride = size;
    image.pixel_stride = size * channels;
    image.row_stride = size * channels * width;
    image.sample_stride = size * channels * width * height;
    return image;
}

/* A buffer that a frame may have. */
typedef struct pathfold_buffer {
    const char *name;
    int32_t channels;   /* at most: a descriptor may have fewer */
    int32_t per_sample; /* 1: of every camera sample, 0: of every pixel */
} pathfold_buffer;

/* All `count` buffers; they live as long as the library. */
PATHFOLD_API const pathfold_buffer *pathfold_buffers(size_t *count);

/* ---- Path descriptors --------------------------------------------------------------------------------- */

/* What a renderer tells of a camera sample's path: "samples.descriptor" and "samples.density". Of all the
 * light that a path gathers, by hitting emitters and by sampling them, it is that along the one way which
 * brings most, by luminance; of a path that finds none it is the walk as it went. */

/* Vertices that a descriptor can hold; later ones are left out. */
#define PATHFOLD_MAX_VERTICES 6

/* Stands for the natural logarithm of 0. Smaller values than PATHFOLD_LEAST_VALUE, but for 0, count as it. */
#define PATHFOLD_DEAD_LOG (-100.0f)
#define PATHFOLD_LEAST_VALUE 1e-30f

/* How a path went on at a vertex. Glossy lobes are rough ones that are not diffuse, delta lobes are mirrors
 * and clear glass; at a light sample it is the lobe that reflects most of it. */
typedef enum pathfold_kind {
    PATHFOLD_KIND_NONE = 0,    /* no vertex: the path has ended */
    PATHFOLD_KIND_GENERIC = 3, /* not known, or none of these: in a medium for example */
    PATHFOLD_KIND_DIFFUSE_REFLECTION = 5,
    PATHFOLD_KIND_DIFFUSE_TRANSMISSION = 6,
    PATHFOLD_KIND_GLOSSY_REFLECTION = 9,
    PATHFOLD_KIND_GLOSSY_TRANSMISSION = 10,
    PATHFOLD_KIND_DELTA_REFLECTION = 17,
    PATHFOLD_KIND_DELTA_TRANSMISSION = 18
} pathfold_kind;

/* A vertex where a path was scattered. A surface that lets it pass straight on, an alpha mask for example, is
 * none: its weight is multiplied into the attenuation of the next vertex, or into the light where none comes.
 */
typedef struct pathfold_vertex {
    float attenuation[3]; /* RGB, >= 0: BSDF times |cosine|, of a delta lobe its reflectance; not divided by a
                             density, with the weight of what let the path pass before it. Not known: 1 */
    int32_t kind;         /* a pathfold_kind. Not known: PATHFOLD_KIND_GENERIC */
    float roughness; /* in [0, 1]: alpha of the microfacets, 0 of delta lobes, 1 of diffuse ones. Not known: 0
                      */
    float density;   /* >= 0, per steradian: with which the next direction was sampled, from the lobes or
                        towards the emitter, or the probability of a delta lobe; times that of surviving
                        Russian roulette. Not known: 1 */
} pathfold_vertex;

typedef struct pathfold_path {
    float
        light[3]; /* RGB radiance, >= 0, that the emitter sends towards the last vertex; 0: none was found */
    int32_t vertex_count;            /* of all vertices up to that light, whether they are recorded or not */
    const pathfold_vertex *vertices; /* from the camera on; at least the recorded ones of vertex_count. A
                                        light sample ends its path with a vertex of its own */
} pathfold_path;

/* Where the channels of a descriptor lie: the first of each kind. */
typedef struct pathfold_layout {
    int32_t radiance;    /* RGB: ln of light times the recorded attenuations */
    int32_t light;       /* RGB: ln */
    int32_t attenuation; /* RGB of each vertex: ln. Logarithms end where kinds begin */
    int32_t kind;        /* of each vertex, 0 where the path has ended */
    int32_t roughness;   /* of each vertex, 0 where the path has ended */
    int32_t channels;    /* of the whole descriptor */
} pathfold_layout;

/* The layout of descriptors of 1 to PATHFOLD_MAX_VERTICES vertices. */
static inline pathfold_layout pathfold_descriptor_layout(int vertices) {
    pathfold_layout layout;
    layout.radiance = 0;
    layout.light = 3;
    layout.attenuation = 6;
    layout.kind = 6 + 3 * vertices;
    layout.roughness = 6 + 4 * vertices;
    layout.channels = 6 + 5 * vertices;
    return layout;
}

/* The vertices that a descriptor of so many channels holds; 0 where it is none. */
static inline int pathfold_descriptor_vertices(int64_t channels) {
    int vertices;
    for (vertices = 1; vertices <= PATHFOLD_MAX_VERTICES; ++vertices)
        if (pathfold_descriptor_layout(vertices).channels == channels)
            return vertices;
    return 0;
}

/* Fills in a path: the channels of a descriptor of `vertices` vertices, float32 side by side, and the density
 * (may be null), the sum of the recorded vertices' ln(density).
 * PATHFOLD_INVALID_ARGUMENT: a value of a recorded vertex or the light is out of its range. What is NaN or
 * infinite, or 0 times infinite, stays so: such a sample is dropped and counted when a frame is denoised. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_describe_path(const pathfold_path *path, int vertices,
                                                                      float *descriptor, float *density);

/* ---- Denoiser ----------------------------------------------------------------------------------------- */

/* One model applied to frames. It keeps the working memory of the last run for the next one; a frame that
 * needs less than half of it gives it back first. One call at a time: while it runs,
 * every other call on it, from the progress callback or another thread, is refused with
 * PATHFOLD_INVALID_ARGUMENT and changes nothing; but for pathfold_denoiser_cancel and _release.
 *
 * After fork() a child can use what it inherits: networks are loaded anew from the model's folder by the
 * first run, and what surrounds them works on one thread if the parent has denoised. A denoiser that was
 * running says that it is lost; what is released in the child gives nothing back. See docs/integrating.md. */
typedef struct pathfold_denoiser pathfold_denoiser;

/* Called on the thread that runs, with the part done in [0, 1]; returning 0 cancels. It must not leave by an
 * exception or longjmp. */
typedef int (*pathfold_progress)(void *user, float done);

PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_create(const pathfold_model *model,
                                                                        pathfold_denoiser **denoiser);

/* Null is allowed. A denoiser that is running goes when its run is over, until when its pixels must live. */
PATHFOLD_API void pathfold_denoiser_release(pathfold_denoiser *denoiser);

/* Sets a buffer of the frame: "color", "diffuse", "specular", "diffuse.albedo", "albedo", "normal", "depth",
 * "alpha", "variance", "diffuse.variance", "specular.variance", "samples.descriptor", "samples.density",
 * "samples.valid". A descriptor may have fewer than 6 vertices (6 + 5 channels for each) where no path of the
 * frame has more. Normals are in camera space. Where a ray hits nothing, albedo is 1, as on visible lights (a
 * renderer that writes 0 there adds 1 - alpha), normal and depth are 0.
 * Values are taken by their meaning: albedos are clamped to [0, 1]; a depth of 1e9 or more, or none that is
 * finite, is a miss; a variance that is not finite is unknown, never 0; radiance may be negative where a
 * colour lies outside of the gamut. A guide that is the same in every pixel is not used. The report says what
 * was mended. The pixels must live until the run is over. A null image takes the buffer away.
 * PATHFOLD_INVALID_ARGUMENT: no such name, wrong channels, no size. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_set_input(pathfold_denoiser *denoiser,
                                                                           const char *name,
                                                                           const pathfold_image *image);

/* Sets where a result is written: "color", "diffuse", "specular" (where the frame is split) or "alpha".
 * It may be the very memory of the radiance or alpha that is filtered, or lie between the pixels of other
 * buffers, as a member of one struct; a run refuses outputs of which a byte belongs to another output, to
 * another pixel of their own, or to a guide or samples that are read. A null image takes it away. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_set_output(pathfold_denoiser *denoiser,
                                                                            const char *name,
                                                                            const pathfold_image *image);

/* Adds a layer (light group, AOV of radiance), filtered with the beauty's kernels so that layers still add
 * up to it. `part` is "color", or "diffuse" and "specular" in two calls; layers keep their sign. A single
 * layer that comes as "color" makes the whole frame use the one kernel that needs no split. A null image
 * takes the part away. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_set_layer(pathfold_denoiser *denoiser,
                                                                           const char *layer,
                                                                           const char *part,
                                                                           const pathfold_image *image);

/* Sets where the filtered layer is written; as many channels as the layer has. A null image takes it away. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_set_layer_output(
    pathfold_denoiser *denoiser, const char *layer, const pathfold_image *image);

/* 1 where the inputs and layers that are set make a split frame: each branch of the model gets radiance of
 * its own, and the outputs "diffuse" and "specular" can be had. Else 0, also while it runs. */
PATHFOLD_API int pathfold_denoiser_is_split(const pathfold_denoiser *denoiser);

/* Takes all inputs, outputs and layers away, and gives the working memory back; settings stay. */
PATHFOLD_API pathfold_status pathfold_denoiser_clear(pathfold_denoiser *denoiser);

/* Sets a number by name:
 *   "exposure"   what radiance is multiplied with before a network sees it; 0 (default): from the image
 *   "memory_mb"  bound on the working memory of a tile; 0 (default): chosen
 *   "tile"       edge of a square tile in pixels, a multiple of the model's alignment; 0 (default): chosen
 *   "samples_per_pixel"  of the frame; 0 (default): as many as its samples buffers have;
 *                        these may hold the first samples of a pixel alone, see samples_per_pixel.embedded
 * PATHFOLD_INVALID_ARGUMENT: no such name, or out of range. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_set_number(pathfold_denoiser *denoiser,
                                                                            const char *name, double value);

/* Sets what is left out where a frame does not need it: "all" (default, every exact one), "none", or names
 * with commas between. Exact, the result stays the same: "branches" (of the model, that change nothing in the
 * frame or a tile), "tiles" (in which nothing changes anything). Approximate, by name only, "all,converged"
 * for example: "converged" (tiles of at least 16 samples per pixel and known variance whose expected RelL2 is
 * at most 1e-4 are copied), "paths" (the samples' descriptors, from as many samples per pixel on as the
 * model's manifest says). The report says what was left out and what that saved, by the times of the same
 * run. PATHFOLD_INVALID_ARGUMENT: no such name. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_set_leave_out(pathfold_denoiser *denoiser,
                                                                               const char *names);

/* Sets the progress callback; null takes it away. */
PATHFOLD_API pathfold_status pathfold_denoiser_set_progress(pathfold_denoiser *denoiser,
                                                            pathfold_progress progress, void *user);

/* What a run comes to. A tile's window is the tile and its overlap: what a network sees at once. */
typedef struct pathfold_plan {
    size_t size;
    int64_t tile_width, tile_height; /* of the largest tile, without its overlap */
    int64_t tiles;
    int64_t window_pixels; /* of the largest window */
    int64_t pixels;        /* of all windows: the overlap makes them more than the frame's */
    int64_t window_bytes;  /* held for the largest window, as far as it is known: what "memory_mb" bounds */
    int64_t frame_bytes;   /* held for the whole frame beside the caller's images */
} pathfold_plan;

static inline pathfold_plan pathfold_plan_init(void) {
    pathfold_plan plan;
    plan.size = sizeof plan;
    plan.tile_width = plan.tile_height = plan.tiles = plan.window_pixels = plan.pixels = 0;
    plan.window_bytes = plan.frame_bytes = 0;
    return plan;
}

/* Tells what a run of the frame that is set would come to, by its sizes alone: the images' `data` may still
 * be null, and what would be left out is not known. Fails where the run would for its sizes and settings.
 * PATHFOLD_UNSUPPORTED: `plan` needs a newer pathfold. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_plan(const pathfold_denoiser *denoiser,
                                                                      pathfold_plan *plan);

/* Denoises the frame into the outputs that were set. Outputs are finite and lie between the least and largest
 * values around, so they are negative only where the input is. Where "color" is set beside diffuse and
 * specular, these are made to add up to it. PATHFOLD_INVALID_ARGUMENT: a buffer that the model requires is
 * missing, sizes differ, or an image has no data. PATHFOLD_CANCELLED: the callback or
 * pathfold_denoiser_cancel said so; outputs are then partly written. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_denoiser_run(pathfold_denoiser *denoiser);

/* Ends the run that is going on, from any thread (not from a signal handler): it returns PATHFOLD_CANCELLED
 * soon, in the middle of a tile too. Does nothing where none runs, and null is allowed. */
PATHFOLD_API void pathfold_denoiser_cancel(pathfold_denoiser *denoiser);

/* The report of the last run as JSON: what was used, what was left out and why, milliseconds per stage.
 * "sanitised" says by buffer what was wrong and, in brackets, what was made of it, in how many pixels:
 * {"albedo": {"above 1 (clamped)": 5120}}; "notes" are sentences. "{}" before the first run, while one is
 * going on, and where the last one failed. Valid until the next run. */
PATHFOLD_API const char *pathfold_denoiser_report(const pathfold_denoiser *denoiser);

/* ---- Pieces, for tools and tests ---------------------------------------------------------------------- */

/* The exposure that a run would choose for `color` (3 channels), by the rule of the shipped models. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_auto_exposure(const pathfold_image *color,
                                                                      float *exposure);

/* Applies size x size kernels (odd, at most 63): softmax of `logits` over the taps inside the image whose
 * value is finite. `logits` is packed float32 [size * size][height][width], taps row by row, correlation.
 * `result` has the size and channels of `image`. */
PATHFOLD_API PATHFOLD_MUST_USE pathfold_status pathfold_gather(const pathfold_image *image,
                                                               const float *logits, int size,
                                                               const pathfold_image *result);

#ifdef __cplusplus
}
#endif
#endif
