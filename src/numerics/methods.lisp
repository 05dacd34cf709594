;;; anmech: the methods of integration: what each says of itself, and how one is found.
;;;
;;; A method is a file of numerics/integrators/ that registers itself:
;;;
;;;     (register-integrator "name" :run (lambda (task) ...) ...)
;;;
;;; with what the structure INTEGRATOR lists.  Nothing else in the package knows its name.  Its function RUN makes a
;;; motion of a task (motion.lisp).  Most have little to write of it: MOTION-BY-FORMULA (accuracy.lisp) wants a formula
;;; for one step with an estimate of its error, ACCURATE-MOTION any integration to a tolerance, MOTION-OF-EQUAL-STEPS
;;; (equal_steps.lisp) what takes steps of equal length.  A method that needs more of a system than its equations of
;;; motion names a function of a module: function(sys, names of parameters, options of the method), which returns a list
;;; of something, the task's slot PREPARED, and of the list of those of PRESERVES that are kept for this very system.
;;;
;;; Entry points: REGISTER-INTEGRATOR, ENUMERATION, INTEGRATOR-NAMED, GIVEN-OPTIONS, MOTION-OF-TASK, TOGETHER-P,
;;; MOTIONS-TOGETHER;
;;; $anmech_method, $anmech_method_names, $anmech_method_takes, $anmech_method_chooses_steps, $anmech_method_options,
;;; $anmech_prepared, $anmech_motion.

(in-package :anmech)
(needs "session/patience" "session/structures" "session/texts" "session/verbs" "numerics/integration" "numerics/model"
       "numerics/motion" "numerics/progress")

(defstruct integrator
  name                   ; a symbol of Maxima, as are all names here
  kinds                  ; heads of the systems that it takes; nil: all
  advice                 ; for those who have a system of another kind: the end of a sentence, or nil
  all-states             ; whether it integrates all of them: then there is no option observe
  options                ; names of the options of integrate_motion that it has for itself
  check                  ; function (options), an alist: what is wrong with them, a sentence, or nil; or nil
  preserves              ; names of what it keeps beside constraints, such as two_form
  numbers                ; what it computes with
  module function        ; where the rest is derived from a system: a module, and a function of it; or nil
  stiff                  ; whether it is for stiff equations
  suits                  ; function (kind given): how well it suits such systems where no method was chosen, GIVEN
                         ; being an alist of its own options, or nil; or nil
  many together          ; the name of an option with which it makes many motions of a system together, and none alone;
                         ; and function (task kept), which for TASK, the first of these, of which something is KEPT on
                         ; the way, or not, gives a function of a list of tasks: the list of their motions, nil of
                         ; those that it leaves to RUN; or nil
  outdoes                ; function (task): why it costs less than the method that suits all systems, a sentence; or
                         ; nil, where it does not; or nil
  run)                   ; function (task): the motion

(defvar *integrators* '() "Those that were registered, the last first.")

(defun maxima-name (text)
  "The symbol that a user who types TEXT, in small letters, means."
  (intern (concatenate 'string "$" (string-upcase text)) :maxima))

(defun register-integrator (name &key kinds advice all-states options check preserves (numbers :double) module function
                                   stiff suits many together outdoes run)
  "Names are texts, as the user types them."
  (when (string= name "auto") (error "auto is no name for a method: it stands for that which suits best"))
  (flet ((symbols (texts) (mapcar #'maxima-name texts)))
    (let ((integrator (make-integrator :name (maxima-name name) :kinds (symbols kinds) :advice advice
                                       :all-states all-states :options (symbols options) :check check
                                       :preserves (symbols preserves) :numbers numbers :module module
                                       :function (and function (maxima-name function)) 
                                       :stiff stiff :suits suits :many (and many (maxima-name many)) :together together
                                       :outdoes outdoes :run run)))
      (setq *integrators* (cons integrator
                                (remove (integrator-name integrator) *integrators* :key #'integrator-name)))
      (integrator-name integrator))))

(defvar *integrators-sought* nil)

(defun integrators ()
  "All of them, in the order of their registration.  The files are loaded together, when integrate_motion is read: which
options and methods there are, and which one suits best, only all of them together tell; a compiled file takes less than
a millisecond."
  (unless *integrators-sought*
    (dolist (file (sort (mapcar #'pathname-name (directory (source-file "numerics/integrators/*"))) #'string<))
      (load-kernel (concatenate 'string "numerics/integrators/" file)))
    (setq *integrators-sought* t))
  (reverse *integrators*))

(defun integrator-named (name)
  (or (find name (integrators) :key #'integrator-name)
      (complain "no method ~a; the methods are ~a" (one-line name)
                (enumeration (cons "auto" (names-of-integrators (integrators))) "and"))))

(defun names-of-integrators (integrators)
  (mapcar (lambda (integrator) (plain-name (integrator-name integrator))) integrators))

(defun enumeration (words last)
  "WORDS as in  a, b and c."
  (format nil "~{~a~^, ~}~@[ ~a~]" (or (butlast words) words)
          (and (rest words) (format nil "~a ~a" last (first (last words))))))

(defun takes-p (integrator kind)
  (or (null (integrator-kinds integrator)) (member kind (integrator-kinds integrator))))

(defun suitable-integrator (kind given)
  "The one that suits systems of KIND best, with the options in GIVEN, an alist."
  (flet ((merit (integrator)
           (or (and (integrator-suits integrator)
                    (takes-p integrator kind)
                    (funcall (integrator-suits integrator) kind given))
               0)))
    (reduce (lambda (best other) (if (> (merit other) (merit best)) other best)) (integrators))))

;;; What integrate_motion asks

(defun given-options (equations)
  "An alist of those that are not auto."
  (loop for (nil name value) in (rest equations)
        unless (eq value 'maxima::$auto) collect (cons name value)))

(maxima::defmfun maxima::$anmech_method_options (name)
  "anmech_method_options('name): the options of all methods become the set of this name, auto if they are not given."
  (let ((options (remove-duplicates (reduce #'append (integrators) :key #'integrator-options) :from-end t))
        (auto '((maxima::mquote maxima::simp) maxima::$auto)))
    (declare-option-set name (mapcar (lambda (option) (list option auto)) options))))

(maxima::defmfun maxima::$anmech_method (name kind observing options)
  "anmech_method(name, kind, observing, [option = value, ...]): the method of this name, or for auto the one that suits
systems of the kind, and has the options; an error if it does not take them, or has not these options, or cannot
leave out states."
  (let* ((integrator (if (eq name 'maxima::$auto)
                         (suitable-integrator kind (given-options options))
                         (integrator-named name)))
         (name (integrator-name integrator)))
    (check-kind integrator kind)
    (when (and observing (integrator-all-states integrator))
      (complain "method = ~a integrates all variables: it has no option observe" (plain-name name)))
    (check-options integrator (given-options options))
    name))

(maxima::defmfun maxima::$anmech_method_takes (name kind)
  "anmech_method_takes(name, kind): whether the method integrates systems of the kind."
  (and (takes-p (integrator-named name) kind) t))

(maxima::defmfun maxima::$anmech_method_names ()
  "anmech_method_names(): of all methods, in the order of their registration."
  (cons '(maxima::mlist maxima::simp) (mapcar #'integrator-name (integrators))))

(maxima::defmfun maxima::$anmech_method_chooses_steps (name)
  "anmech_method_chooses_steps(name): whether it finds steps for an accuracy; false if its user must give a step_size."
  (let ((check (integrator-check (integrator-named name))))
    (not (and check
              (funcall check '())
              (null (funcall check '((maxima::$step_size . 1))))))))

(defun check-kind (integrator kind)
  (unless (takes-p integrator kind)
    (complain "method = ~a needs ~a, found ~a~@[; ~a~]"
              (plain-name (integrator-name integrator))
              (enumeration (mapcar (lambda (head) (with-article (plain-name head))) (integrator-kinds integrator)) "or")
              (with-article (plain-name kind))
              (integrator-advice integrator))))

(defun check-options (integrator options)
  "Complain of one of OPTIONS that another method has, or of what the method itself finds wrong."
  (let ((strange (find-if-not (lambda (name) (member name (integrator-options integrator))) options :key #'car)))
    (when strange
      (flet ((has-it-p (other) (member (car strange) (integrator-options other))))
        (complain "~a is an option of method = ~a" (plain-name (car strange))
                  (enumeration (names-of-integrators (remove-if-not #'has-it-p (integrators))) "or")))))
  (let ((trouble (and (integrator-check integrator) (funcall (integrator-check integrator) options))))
    (when trouble (complain "~a" trouble))))

(maxima::defmfun maxima::$anmech_prepared (name sys names options)
  "anmech_prepared(method, sys, [parameter, ...], [option = value, ...]): a list of what the method needs of the system
beside its equations, and of the list of what it keeps of it."
  (let* ((integrator (integrator-named name)) (function (integrator-function integrator)))
    (cond (function
           (need-module (integrator-module integrator))
           (maxima::mapply1 function (list sys names options) function nil))
          (t (list '(maxima::mlist maxima::simp) nil
                   (cons '(maxima::mlist maxima::simp) (integrator-preserves integrator)))))))

(defun stiff-integrator () (find-if #'integrator-stiff (integrators)))

(defparameter *patient-at-first* 20000 "So many steps of a motion that is stiff are taken where another method may be.")

(defun motion-of-task (task integrator)
  "The motion, the integrator that has made it, and why this one, a sentence."
  (if (task-option task 'maxima::$chosen)
      (let ((motion (told-motion task integrator)))
        (when (stiff-motion-p motion integrator) (advise-stiff motion (stiff-integrator)))
        (values motion integrator "it was asked for"))
      (motion-of-suitable task integrator)))

(defun motion-of-suitable (task integrator)
  "The same where nobody has chosen it: another than INTEGRATOR may cost less; what ends its motion early, or keeps it
from the accuracy, INTEGRATOR may pass."
  (multiple-value-bind (cheaper why) (cheaper-integrator task integrator)
    (multiple-value-bind (motion maker reason) (motion-past-stiffness task cheaper why)
      (let ((early (ended-early-p motion task)))
        (if (or (eq maker integrator) (not (eq maker cheaper)) (not (or early (inaccurate-p motion task))))
            (values motion maker reason)
            (multiple-value-bind (other maker reason)
                (motion-past-stiffness task integrator
                                       (format nil "~a, but ~:[are less accurate~;end earlier~]" why early))
              (incf (motion-evaluations other) (motion-evaluations motion))
              (cond ((better-motion-p motion other) (values motion cheaper why))
                    (t (when (may-have-missed-p other motion early task) (doubt-motion other motion cheaper))
                       (values other maker reason)))))))))

(defparameter *astray* 0.1d0 "A larger error is none of a motion that was followed, but of one that missed something.")

(defun may-have-missed-p (motion other early task)
  "Whether MOTION, which is good by itself, may have stepped over what OTHER, which came as far but is not EARLY, knows
that it has missed."
  (and (not early)
       (> (motion-error-estimate other) *astray*)
       (not (inaccurate-p motion task))))

(defun doubt-motion (motion other maker)
  "Of MOTION no more is claimed than of OTHER, by MAKER."
  (setf (motion-error-estimate motion) (motion-error-estimate other)
        (motion-message motion)
        (sentences (motion-message motion)
                   (format nil "what method = ~a has missed may have been stepped over here: ~a"
                           (plain-name (integrator-name maker)) (motion-message other)))))

(defun motion-past-stiffness (task integrator why)
  "The motion by INTEGRATOR, or where stiffness ends that, by another, and why that."
  (unless (integrator-stiff integrator) (lower-patience task))
  (let ((motion (told-motion task integrator)))
    (if (stiff-motion-p motion integrator)
        (values (stiff-motion task motion (stiff-integrator)) (stiff-integrator) "the equations are stiff")
        (values motion integrator why))))

(defun ended-early-p (motion task)
  "Whether MOTION has met what another method might pass: not an event, nor the patience of its user; but the steps that
are taken where nobody says how many are enough of one method."
  (let ((integration (motion-integration motion)))
    (and (/= (motion-reached motion) (problem-end (task-problem task)))
         (null (integration-ended-by integration))
         (not (eq :interrupted (integration-status integration)))
         (not (and (task-max-steps task) (eq :too-many-steps (integration-status integration)))))))

(defparameter *far-off* 100 "An error that is so many times the accuracy is not due to rounding alone.")

(defun inaccurate-p (motion task)
  (let ((error (motion-error-estimate motion)))
    (and error (task-verify task)
         (not (eq :interrupted (integration-status (motion-integration motion))))
         (> error (* *far-off* (task-accuracy task))))))

(defun better-motion-p (motion other)
  "Whether MOTION comes farther than OTHER, or as far, and not with more of an error."
  (flet ((way (motion) (abs (- (motion-reached motion) (start-time motion)))))
    (let ((way (way motion)) (other-way (way other)))
      (or (> way other-way)
          (and (= way other-way)
               (let ((error (motion-error-estimate motion)) (other-error (motion-error-estimate other)))
                 (or (null other-error) (and error (<= error other-error)))))))))

(defun stiff-motion-p (motion integrator)
  "Whether stiffness has ended MOTION, and another integrator is for that."
  (and (eq :stiff (integration-status (motion-integration motion)))
       (not (integrator-stiff integrator))
       (stiff-integrator)))

(defun cheaper-integrator (task integrator)
  "The one that costs less for TASK than INTEGRATOR, which suits all systems, if there is one, and why; else
INTEGRATOR."
  (if (integrator-options integrator)
      (values integrator "options of its own were given")
      (dolist (other (integrators) (values integrator "it suits all systems that are not stiff"))
        (let ((why (and (integrator-outdoes other) (funcall (integrator-outdoes other) task))))
          (when why (return (values other why)))))))

(defun lower-patience (task)
  (let ((problem (task-problem task)))
    (setf (problem-patience problem) (min (problem-patience problem) *patient-at-first*))))

(defun advise-stiff (motion other)
  (setf (motion-message motion)
        (sentences (motion-message motion)
                   (format nil "method = ~a is for stiff equations" (plain-name (integrator-name other))))))

(defun stiff-motion (task motion other)
  "By the integrator OTHER, with what the MOTION that has ended found of stiffness, and what it cost."
  (setf (problem-stiffness (task-problem task)) nil)
  (let ((again (told-motion task other)))
    (setf (integration-stiffness (motion-integration again)) (integration-stiffness (motion-integration motion)))
    (incf (motion-evaluations again) (motion-evaluations motion))
    again))

(defun told-motion (task integrator)
  (let ((motion (funcall (integrator-run integrator) task)))
    (check-constants motion task)
    (setf (motion-unverified motion) (not (task-verify task)))
    motion))

(defun together-p (integrator options)
  "Whether the option is among OPTIONS, an alist, with which INTEGRATOR makes many motions together."
  (cdr (assoc (integrator-many integrator) options)))

(defun motions-together (integrator task kept)
  "The function that makes many motions like that of TASK together, if that is asked for; nil: one by one."
  (and (together-p integrator (task-options task)) (funcall (integrator-together integrator) task kept)))

(maxima::defmfun maxima::$anmech_motion (name model prepared states interval parameters options)
  "anmech_motion(method, model, prepared, [state, ...], [t0, t1], [parameter, ...], [option = value, ...]): the record
of a motion; all numbers may be exact."
  (let* ((options (given-options options))
         (progress (assoc 'maxima::$progress options))
         (line (progress-line (if progress (cdr progress) 'maxima::$auto)))
         (clock (get-internal-real-time))
         (task (new-task model prepared (rest states) (rest interval) (rest parameters) options line))
         (integrator (integrator-named name)) (motion nil) (why nil))
    (when (together-p integrator options)
      (complain "~a = true is for many motions, of which only the ends are asked for: integrate_motions, sweep"
                (plain-name (integrator-many integrator))))
    (unwind-protect (multiple-value-setq (motion integrator why)
                      (call-noting-interruptions (lambda () (motion-of-task task integrator))))
      (when line (funcall line)))
    (push (cons 'maxima::$method (integrator-name integrator)) (motion-facts motion))
    (push (cons 'maxima::$why why) (motion-facts motion))
    (setf (motion-seconds motion) (seconds-since clock))
    (incf (motion-compile-seconds motion) (model-seconds model))
    (setf (model-seconds model) 0d0)
    motion))
