/* A physics again on the processor, for HAIRGRAD_VALIDATE: the same energies of the same groom, and a frame whose tensors are read
 * from the device. */
#include "hairloss/physics.h"

#include <string.h>

/* The copy that is among the inputs, or a new one. */
static hg_tensor *copy_of(const hg_call *call, hg_ctx *host, hg_tensor *const *in, const hg_tensor *tensor)
{
    if (!tensor) return NULL;
    for (int i = 0; i < call->n_in; i++)
        if (call->in[i] == tensor) return in[i];
    hg_tensor *copy = hg_tensor_make(host, tensor->dtype, tensor->rank, tensor->shape);
    return copy && hg_tensor_read(tensor, copy->data) == HG_OK ? copy : NULL;
}

hg_tensor *hg_physics_twin(hg_physics *twin, const hg_frame *frame, const hg_call *call, hg_ctx *host,
                           hg_tensor *const *in)
{
    hg_frame again = *frame;
    hg_tensor **members[] = { &again.root_rotation, &again.root_position, &again.posed,
                              &again.predicted,     &again.previous,      &again.body_vertices };
    for (size_t i = 0; i < sizeof members / sizeof *members; i++) {
        const hg_tensor *tensor = *members[i];
        *members[i] = copy_of(call, host, in, tensor);
        if (tensor && !*members[i]) return NULL;
    }
    hg_frame_input *inputs = hg_step_alloc(host, (size_t)(frame->n_inputs + 1) * sizeof *inputs);
    if (!inputs) return NULL;
    for (int i = 0; i < frame->n_inputs; i++) {
        inputs[i] = (hg_frame_input){ frame->inputs[i].name, copy_of(call, host, in, frame->inputs[i].value) };
        if (!inputs[i].value) return NULL;
    }
    again.inputs = inputs;
    return (hg_physics_energy)(twin, host, &again, in[0], NULL);
}
