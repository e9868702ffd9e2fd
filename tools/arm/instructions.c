/* A plugin for qemu-user: how often each kind of instruction was executed, by mnemonic, and how many different ones.
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

__attribute__((visibility("default"))) int qemu_plugin_version = 1;

enum { KINDS = 4096, LENGTH = 24, ADD = 0 };
static struct { char name[LENGTH]; uint64_t *count; } kinds[KINDS];
static int used;
static uint64_t different;

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

static void on_translation(qemu_plugin_id_t id, struct qemu_plugin_tb *block) {
    (void)id;
    const size_t count = qemu_plugin_tb_n_insns(block);
    different += count;
    for (size_t i = 0; i < count; i++) {
        struct qemu_plugin_insn *instruction = qemu_plugin_tb_get_insn(block, i);
        char *text = qemu_plugin_insn_disas(instruction);
        qemu_plugin_register_vcpu_insn_exec_inline(instruction, ADD, counter(text), 1);
        free(text);
    }
}

static void at_end(qemu_plugin_id_t id, void *unused) {
    (void)id;
    (void)unused;
    FILE *file = fopen(getenv("INSTRUCTIONS"), "w");
    if (!file) return;
    for (int i = 0; i < used; i++) fprintf(file, "%llu %s\n", (unsigned long long)*kinds[i].count, kinds[i].name);
    fprintf(file, "%llu DIFFERENT\n", (unsigned long long)different);
    fclose(file);
}

__attribute__((visibility("default"))) int qemu_plugin_install(qemu_plugin_id_t id, const qemu_info_t *info, int argc,
                                                               char **argv) {
    (void)info;
    (void)argc;
    (void)argv;
    qemu_plugin_register_vcpu_tb_trans_cb(id, on_translation);
    qemu_plugin_register_atexit_cb(id, at_end, 0);
    return 0;
}
