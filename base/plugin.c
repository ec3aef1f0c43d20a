/* Plug-ins: shared objects whose constructors register what they bring. One that is wrong anywhere is not taken at all. */
#include "base/internal.h"

#include <dlfcn.h>
#include <stdio.h>
#include <string.h>

static const hg_declaration *declaration_of(const char *kind)
{
    char name[64];
    snprintf(name, sizeof name, "%s", kind);
    for (char *at = name; *at; at++)
        if (*at == ' ') *at = '_';
    return hg_find("declaration", name);
}

static hg_status check(const char *path, const hg_registering *brought)
{
    if (brought->wrong[0]) {
        const char *end = strstr(brought->wrong, "; the first one is used");
        if (!end) return hg_fail(HG_INVALID, "%s: %s", path, brought->wrong);
        return hg_fail(HG_INVALID, "%s: %.*s: the name is taken, choose another one", path, (int)(end - brought->wrong),
                       brought->wrong);
    }
    if (brought->n == 0)
        return hg_fail(HG_INVALID, "%s: it registers nothing; is there an HG_ENERGY, HG_OP or HG_REGISTER in it?",
                       path);
    for (int i = 0; i < brought->n; i++) {
        const hg_entry *entry = brought->entry[i];
        const hg_declaration *declaration = declaration_of(entry->kind);
        if (!declaration) continue;
        const hg_status status = declaration->check(entry->name, entry->item);
        if (status == HG_OK) continue;
        char *sentence = hg_strdup(hg_message());
        if (!sentence) return HG_MEMORY;
        hg_fail(status, "%s: %s", path, sentence);
        hg_free(sentence);
        return status;
    }
    return HG_OK;
}

hg_status hg_plugin_load(const char *path)
{
    /* without a slash dlopen would look in the folders of the system */
    char *local = strchr(path, '/') ? hg_strdup(path) : hg_format("./%s", path);
    if (!local) return HG_MEMORY;
    void *known = dlopen(local, RTLD_NOW | RTLD_LOCAL | RTLD_NOLOAD);
    if (known) {
        dlclose(known);
        hg_free(local);
        return HG_OK;
    }
    hg_registering *brought = hg_alloc(1, sizeof *brought);
    if (!brought) {
        hg_free(local);
        return HG_MEMORY;
    }
    hg_registry_watch(brought);
    void *handle = dlopen(local, RTLD_NOW | RTLD_LOCAL);
    hg_registry_watch(NULL);
    hg_status status;
    if (handle) {
        status = check(path, brought);
    } else {
        const char *why = dlerror();
        const size_t length = strlen(local);
        if (strncmp(why, local, length) == 0 && strncmp(why + length, ": ", 2) == 0) why += length + 2;
        status = hg_fail(HG_IO, "%s: it cannot be loaded as a plug-in (%s)", path, why);
    }
    if (status != HG_OK)
        for (int i = 0; i < brought->n; i++) hg_registry_forget(brought->entry[i]);
    if (status != HG_OK && handle) dlclose(handle);
    hg_free(brought);
    hg_free(local);
    return status;
}

hg_status hg_plugins_load(const char *list)
{
    while (list && *list) {
        const size_t length = strcspn(list, ":");
        char *path = hg_format("%.*s", (int)length, list);
        const hg_status status = !path ? HG_MEMORY : length > 0 ? hg_plugin_load(path) : HG_OK;
        hg_free(path);
        HG_TRY(status);
        list += length + (list[length] == ':');
    }
    return HG_OK;
}
