;;; anmech: programs in C for the motions of a system, several at a time in the lanes of a processor's registers.
;;;
;;; Such a program consists of lanes.c, the same for all systems, and of what stands in it for the line "the system":
;;; sizes, tables, and straight code for the coefficients of each order, from the forms that the kernel's loop and its
;;; own straight code have (series_kernel.lisp): sums are added in the same order.
;;;
;;; Entry point: LANES-PROGRAM.

(in-package :anmech)
(needs "session/whole_files" "numerics/dag" "numerics/foreign_code" "numerics/series_code" "numerics/series_kernel"
       "numerics/series_program")

;;; Forms of the kernel's as expressions of C

(defun c-place (place kernel room)
  "The element for PLACE of the kernel's array; of each series there are ROOM coefficients."
  (let ((constants (series-kernel-constants kernel)))
    (if (< place constants)
        (multiple-value-bind (series order) (floor place +room+) (+ (* room series) order))
        (+ (* room (floor constants +room+)) (- place constants)))))

(defun c-expression (form kernel room)
  "Text of FORM; sums are added in its order."
  (flet ((text (form) (c-expression form kernel room)))
    (cond ((realp form) (foreign-number (rational form) (language-named 'maxima::$c)))
          ((eq 'aref (first form)) (format nil "w[~d]" (c-place (third form) kernel room)))
          ((eq 'sqrt (first form)) (format nil "root(~a)" (text (second form))))
          ((null (cddr form)) (format nil "(~a~a)" (first form) (text (second form))))
          (t (format nil (format nil "(~~{~~a~~^ ~a ~~})" (first form)) (mapcar #'text (rest form)))))))

(defun c-coefficients (kernel order room)
  "The function for the coefficients of ORDER > 0 of all instructions."
  (append (list "" (format nil "static void coefficients_~d(numbers *restrict w) {" order))
          (loop for (place . form) in (straight-forms kernel order)
                repeat (length (series-kernel-instructions kernel))
                collect (format nil "  w[~d] = ~a;" (c-place place kernel room)
                                (if (realp form)
                                    (format nil "all(~a)" (c-expression form kernel room))
                                    (c-expression form kernel room))))
          (list "}")))

;;; Order 0

(defun c-function (operation)
  "The name of the function of C that carries out OPERATION."
  (let ((language (language-named 'maxima::$c)))
    (let ((control (second (assoc operation (language-functions language)))))
      (subseq control 0 (position #\( control)))))

(defun domain-in-c (operation a b)
  "The condition on A and B, texts, under which OPERATION has a value; nil: always."
  (case operation
    (:divide (format nil "~a != 0.0" b))
    (:sqrt (format nil "~a >= 0.0" a))
    (:log (format nil "~a > 0.0" a))
    (:expt (format nil "(~a > 0.0 || (~a == 0.0 && ~a > 0.0))" a a b))
    ((:asin :acos) (format nil "fabs(~a) <= 1.0" a))
    (:acosh (format nil "~a >= 1.0" a))
    (:atanh (format nil "fabs(~a) < 1.0" a))))

(defun functions-of-kernel (kernel)
  "The operations that functions of C carry out in the instructions of order 0."
  (remove-duplicates (loop for (operation a) across (series-kernel-instructions kernel)
                           append (case operation
                                    ((:primitive :primitive-over) (remove :cos (remove :sin (list a))))
                                    (:angle '(:atan2))
                                    (:power '(:expt))))))

(defun c-value (instruction place kernel room)
  "The statement for the value of INSTRUCTION at PLACE of the kernel's array."
  (destructuring-bind (operation a &optional b c d) instruction
    (declare (ignore d))
    (let ((constants (series-kernel-constants kernel)))
      (labels ((text (form) (c-expression form kernel room))
               (at (series) (* +room+ series))
               (series (series) (text `(aref work ,(at series))))
               (constant (number) `(aref work ,(+ constants number)))
               (value (text) (format nil "  w[~d] = ~a;" (c-place place kernel room) text))
               (function-of (operation &rest arguments)
                 (value (format nil "~a_of(~{~a, ~}on)" (c-function operation) arguments))))
        (case operation
          (:primitive (if (eq a :sin)                    ; the cosine follows
                          (format nil "  sine_and_cosine(~a, on, w + ~d, w + ~d);" (series b)
                                  (c-place place kernel room) (c-place (+ place +room+) kernel room))
                          (function-of a (series b))))
          (:primitive-over (function-of a (series b)))
          (:angle (function-of :atan2 (series a) (series b)))
          (:power (function-of :expt (series a) (text (constant b))))
          (:fixed (value (text (constant a))))
          ((:shift :scale :over :reciprocal) (value (text (first-form operation (at a) nil (constant b)))))
          (t (value (text (first-form operation (at a) (and b (at b)) c)))))))))

(defun c-values (kernel room)
  "The function for the values of all instructions."
  (append (list "" "static void values(numbers *restrict w, choices on) {" "  (void)on;")
          (loop for instruction across (series-kernel-instructions kernel)
                for place from (* +room+ (1+ (series-kernel-states kernel))) by +room+
                unless (eq :cos (second instruction)) collect (c-value instruction place kernel room))
          (list "}")))

(defun c-constant (head operands)
  "The expression of a constant; OPERANDS are texts."
  (let ((language (language-named 'maxima::$c)))
    (case head
      ((:add :subtract :multiply :divide)
       (format nil "~a ~a ~a" (first operands) (ecase head (:add "+") (:subtract "-") (:multiply "*") (:divide "/"))
               (second operands)))
      (:negate (format nil "-~a" (first operands)))
      (t (format nil "~?" (second (assoc head (language-functions language))) operands)))))

(defun c-constants (series)
  "The function for the constants of one motion: whether they have values."
  (append
   (list "" "static int constants(const double *in, double *c) {" "  (void)in, (void)c;")
   (loop for (head . rest) across (series-program-constants series)
         for i from 0
         append (flet ((line (control &rest arguments) (list (format nil "  c[~d] = ~?;" i control arguments)))
                       (number (rational) (foreign-number rational (language-named 'maxima::$c))))
                  (case head
                    (:input (line "in[~d]" rest))
                    (:number (line "~a" (number rest)))
                    (:constant (line "~a" (number (cdr (assoc rest *constants*)))))
                    (t (let* ((operands (mapcar (lambda (k) (format nil "c[~d]" k)) rest))
                              (domain (domain-in-c head (first operands) (second operands))))
                         (append (and domain (list (format nil "  if (!(~a))" domain) "    return 0;"))
                                 (line "~a" (c-constant head operands))
                                 (list (format nil "  if (!isfinite(c[~d]))" i) "    return 0;")))))))
   (list "  return 1;" "}")))

;;; The whole

(defun place-or-constant (operand kernel)
  "The number of a series, or -1 minus that of a constant."
  (cond ((integerp operand) operand)
        ((eq :unknown (car operand)) (+ (floor (series-kernel-unknowns kernel) +room+) (cdr operand)))
        (t (- -1 (cdr operand)))))

(defun c-table (name numbers) (format nil "static const int ~a[] = {~{~d~^, ~}};" name (or numbers '(0))))

(defun c-tables (kernel roots steep)
  "Lines that tell where rates, roots, steep arguments and the entries of linear equations stand."
  (let* ((series (series-kernel-program kernel)) (linear (series-program-linear series)))
    (flet ((place (operand) (place-or-constant operand kernel)))
      (append (list (c-table "rates" (mapcar #'place (series-program-rates series)))
                    (c-table "roots" roots)
                    (c-table "steep" steep))
              (and linear
                   (list (c-table "rights" (mapcar #'place (linear-series-rights linear)))
                         "static const struct { int row, column, place; } entries[] = {"
                         (format nil "~{    {~{~d~^, ~}}~^,~%~}};"
                                 (loop for (row column operand) in (linear-series-entries linear)
                                       collect (list row column (place operand))))))))))

(defun roots-in (kernel)
  "The numbers of the series that are square roots or powers: they are to stay positive."
  (loop for (operation) across (series-kernel-instructions kernel)
        for index from (1+ (series-kernel-states kernel))
        when (member operation '(:sqrt :power)) collect index))

(defun c-system (kernel order inputs steep)
  "The lines that stand for the system in lanes.c; STEEP are the numbers of series of which functions are taken that may
be so."
  (let* ((series (series-kernel-program kernel)) (linear (series-program-linear series)) (room (+ order 2))
         (roots (roots-in kernel)))
    (append
     (loop for (name number) in `(("STATES" ,(series-kernel-states kernel)) ("ORDER" ,order) ("ROOM" ,room)
                                  ("SERIES" ,(floor (series-kernel-constants kernel) +room+))
                                  ("CONSTANTS" ,(length (series-program-constants series)))
                                  ("UNKNOWNS" ,(if linear (linear-series-size linear) 0))
                                  ("ENTRIES" ,(if linear (length (linear-series-entries linear)) 0))
                                  ("INPUTS" ,inputs) ("ROOTS" ,(length roots)) ("STEEP" ,(length steep)))
           collect (format nil "#define ~a ~d" name number))
     (c-tables kernel roots steep)
     (loop for operation in (functions-of-kernel kernel)
           collect (let ((function (c-function operation)))
                     (format nil "~:[~;PAIR_~]IN_LANES(~a_of, ~a)" (member operation '(:expt :atan2)) function
                             (if (eq operation :expt) "power" function))))
     (c-constants series)
     (c-values kernel room)
     (loop for k from 1 below order append (c-coefficients kernel k room))
     (list "" (format nil "static void (*const coefficients[])(numbers *restrict) = {0~{, coefficients_~d~}};"
                      (loop for k from 1 below order collect k))))))

(defun lanes-program (kernel order inputs steep)
  "The lines of the program for the system of KERNEL, whose polynomials are of ORDER; of each motion there are so many
INPUTS."
  (loop for line in (lines-of-file (source-file "numerics/lanes" "c"))
        append (if (string= line "/* the system */") (c-system kernel order inputs steep) (list line))))
