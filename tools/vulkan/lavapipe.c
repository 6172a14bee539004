/* A Vulkan driver that passes everything on to Mesa's software Vulkan, and mends shaders on the way.
 *
 * For drivers without VK_KHR_workgroup_memory_explicit_layout, as Mesa's software Vulkan is, CubeCL 0.11.3 declares shared
 * memory as a pointer to a pointer (`lower_shared_implicit` of cubecl-spirv), which crashes the driver. Here such a variable
 * gets the type it should have. GPUs have the extension and do not need this.
 *
 *     cc -shared -fPIC -O2 tools/vulkan/lavapipe.c -o target/lavapipe.so -ldl
 *     echo '{"file_format_version": "1.0.0", "ICD": {"api_version": "1.3.0", "library_path": "'$PWD'/target/lavapipe.so"}}' \
 *         > target/lavapipe.json
 *     export VK_ICD_FILENAMES=$PWD/target/lavapipe.json
 *
 * LAVAPIPE names the driver, if it is not libvulkan_lvp.so.
 */
#include <dlfcn.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef void (*Function)(void);
typedef Function (*GetProcAddr)(void *, const char *);

/* VkShaderModuleCreateInfo. */
typedef struct {
    int32_t type;
    const void *next;
    uint32_t flags;
    size_t code_size;
    const uint32_t *code;
} ShaderInfo;

typedef int32_t (*CreateShader)(void *, const ShaderInfo *, const void *, uint64_t *);

enum { HEADER_WORDS = 5, OP_TYPE_POINTER = 32, OP_VARIABLE = 59, STORAGE_WORKGROUP = 4 };

static GetProcAddr device_proc_addr;
static CreateShader create_shader;

static void *driver(const char *name) {
    static void *library;
    if (!library) {
        const char *path = getenv("LAVAPIPE");
        library = dlopen(path ? path : "libvulkan_lvp.so", RTLD_NOW | RTLD_LOCAL);
        if (!library) {
            fprintf(stderr, "%s\n", dlerror());
            return NULL;
        }
    }
    return dlsym(library, name);
}

/* Gives variables in shared memory whose type is a pointer to a pointer the inner type. */
static void mend(uint32_t *code, size_t words) {
    if (words < HEADER_WORDS) return;
    uint32_t bound = code[3];
    /* What each pointer into shared memory points to. */
    uint32_t *pointee = calloc(bound, sizeof *pointee);
    if (!pointee) return;
    for (size_t at = HEADER_WORDS; at < words;) {
        uint32_t count = code[at] >> 16, op = code[at] & 0xffff;
        if (count == 0 || count > words - at) break;
        if (op == OP_TYPE_POINTER && count == 4 && code[at + 2] == STORAGE_WORKGROUP && code[at + 1] < bound) {
            pointee[code[at + 1]] = code[at + 3];
        }
        if (op == OP_VARIABLE && count >= 4 && code[at + 3] == STORAGE_WORKGROUP && code[at + 1] < bound) {
            uint32_t inner = pointee[code[at + 1]];
            if (inner < bound && pointee[inner]) code[at + 1] = inner;
        }
        at += count;
    }
    free(pointee);
}

static int32_t create_mended_shader(void *device, const ShaderInfo *info, const void *allocator, uint64_t *shader) {
    uint32_t *code = malloc(info->code_size);
    if (!code) return -1; /* VK_ERROR_OUT_OF_HOST_MEMORY */
    memcpy(code, info->code, info->code_size);
    mend(code, info->code_size / sizeof *code);
    ShaderInfo mended = *info;
    mended.code = code;
    int32_t result = create_shader(device, &mended, allocator, shader);
    free(code);
    return result;
}

static Function device_function(void *device, const char *name) {
    Function found = device_proc_addr(device, name);
    if (found && !strcmp(name, "vkCreateShaderModule")) {
        create_shader = (CreateShader)found;
        return (Function)create_mended_shader;
    }
    return found;
}

Function vk_icdGetInstanceProcAddr(void *instance, const char *name) {
    GetProcAddr get = (GetProcAddr)driver("vk_icdGetInstanceProcAddr");
    Function found = get ? get(instance, name) : NULL;
    if (found && !strcmp(name, "vkGetDeviceProcAddr")) {
        device_proc_addr = (GetProcAddr)found;
        return (Function)device_function;
    }
    return found;
}

Function vk_icdGetPhysicalDeviceProcAddr(void *instance, const char *name) {
    GetProcAddr get = (GetProcAddr)driver("vk_icdGetPhysicalDeviceProcAddr");
    return get ? get(instance, name) : NULL;
}

int32_t vk_icdNegotiateLoaderICDInterfaceVersion(uint32_t *version) {
    int32_t (*negotiate)(uint32_t *) = (int32_t(*)(uint32_t *))driver("vk_icdNegotiateLoaderICDInterfaceVersion");
    return negotiate ? negotiate(version) : -3; /* VK_ERROR_INITIALIZATION_FAILED */
}
