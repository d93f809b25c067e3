/* A loop for the vectors of newer machines beside that for all, where a compiler can choose as it is loaded. */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__gnu_linux__)
#define FOR_MACHINES __attribute__((target_clones("arch=x86-64-v3", "default")))
#else
#define FOR_MACHINES
#endif
#define INLINE static inline __attribute__((always_inline))
