/* A plugin for qemu-user: how often each kind of instruction was executed in the steps of a program, by mnemonic: in all
 * of them, and in that of the most instructions. A step ends where the instruction at STEP_ENDED is executed; the first
 * SKIPPED are not counted. Writes to INSTRUCTIONS; all three are variables of the environment.
 *
 * The header of the interface (API version 1) is not packaged: what is used of it is declared here. */
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef uint64_t qemu_plugin_id_t;
struct qemu_plugin_tb;
struct qemu_plugin_insn;
typedef struct qemu_info_t qemu_info_t;
typedef void (*translated)(qemu_plugin_id_t, struct qemu_plugin_tb *);
typedef void (*ended)(qemu_plugin_id_t, void *);
void qemu_plugin_register_vcpu_tb_trans_cb(qemu_plugin_id_t, translated);
void qemu_plugin_register_atexit_cb(qemu_plugin_id_t, ended, void *);
void qemu_plugin_register_vcpu_insn_exec_inline(struct qemu_plugin_insn *, int, void *, uint64_t);
size_t qemu_plugin_tb_n_insns(const struct qemu_plugin_tb *);
struct qemu_plugin_insn *qemu_plugin_tb_get_insn(const struct qemu_plugin_tb *, size_t);
char *qemu_plugin_insn_disas(const struct qemu_plugin_insn *);
uint64_t qemu_plugin_insn_vaddr(const struct qemu_plugin_insn *);
typedef void (*executed)(unsigned int, void *);
void qemu_plugin_register_vcpu_insn_exec_cb(struct qemu_plugin_insn *, executed, int, void *);

__attribute__((visibility("default"))) int qemu_plugin_version = 1;

enum { KINDS = 4096, LENGTH = 24, ADD = 0 };
static struct { char name[LENGTH]; uint64_t *count, before, all, most; } kinds[KINDS];
static int used, steps, skipped;
static uint64_t different, most, end;

static uint64_t *counter(const char *text) {
    char name[LENGTH] = {0};
    for (int k = 0; text[k] && text[k] != ' ' && text[k] != '\t' && k < LENGTH - 1; k++) name[k] = text[k];
    for (int i = 0; i < used; i++)
        if (!strcmp(kinds[i].name, name)) return kinds[i].count;
    if (used == KINDS) abort();
    strcpy(kinds[used].name, name);
    kinds[used].count = calloc(1, sizeof(uint64_t));
    return kinds[used++].count;
}

static void on_end_of_step(unsigned int cpu, void *unused) {
    (void)cpu;
    (void)unused;
    uint64_t total = 0;
    for (int i = 0; i < used; i++) total += *kinds[i].count - kinds[i].before;
    const bool heaviest = steps >= skipped && total > most;
    for (int i = 0; i < used; i++) {
        const uint64_t own = *kinds[i].count - kinds[i].before;
        if (steps >= skipped) kinds[i].all += own;
        if (heaviest) kinds[i].most = own;
        kinds[i].before = *kinds[i].count;
    }
    if (heaviest) most = total;
    steps++;
}

static void on_translation(qemu_plugin_id_t id, struct qemu_plugin_tb *block) {
    (void)id;
    const size_t count = qemu_plugin_tb_n_insns(block);
    different += count;
    for (size_t i = 0; i < count; i++) {
        struct qemu_plugin_insn *instruction = qemu_plugin_tb_get_insn(block, i);
        char *text = qemu_plugin_insn_disas(instruction);
        qemu_plugin_register_vcpu_insn_exec_inline(instruction, ADD, counter(text), 1);
        free(text);
        if (qemu_plugin_insn_vaddr(instruction) == end)
            qemu_plugin_register_vcpu_insn_exec_cb(instruction, on_end_of_step, 0, 0);
    }
}

static void at_end(qemu_plugin_id_t id, void *unused) {
    (void)id;
    (void)unused;
    FILE *file = fopen(getenv("INSTRUCTIONS"), "w");
    if (!file) return;
    for (int i = 0; i < used; i++)
        fprintf(file, "%llu %llu %s\n", (unsigned long long)kinds[i].all, (unsigned long long)kinds[i].most, kinds[i].name);
    fprintf(file, "%d %llu DIFFERENT\n", steps - skipped, (unsigned long long)different);
    fclose(file);
}

__attribute__((visibility("default"))) int qemu_plugin_install(qemu_plugin_id_t id, const qemu_info_t *info, int argc,
                                                               char **argv) {
    (void)info;
    (void)argc;
    (void)argv;
    end = strtoull(getenv("STEP_ENDED"), 0, 16);
    skipped = atoi(getenv("SKIPPED"));
    qemu_plugin_register_vcpu_tb_trans_cb(id, on_translation);
    qemu_plugin_register_atexit_cb(id, at_end, 0);
    return 0;
}
