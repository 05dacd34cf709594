;;; anmech: derivatives by time in LaTeX, with dots: \ddot{x}.
;;;
;;; Entry points: $anmech_dotted.

(in-package :anmech)
(needs "session/scope")

(defparameter *accents* '("\\dot" "\\ddot" "\\dddot" "\\ddddot"))

(defun dotted-name (variable order)
  "x_{1} with two dots is \\ddot{x}_{1}."
  (let* ((text (string-trim '(#\Space) (coerce (maxima::mfuncall 'maxima::$tex1 variable) 'string)))
         (end (or (position #\_ text) (length text))))
    (concatenate 'string (nth (1- order) *accents*) "{" (subseq text 0 end) "}" (subseq text end))))

(defun dotted (form time)
  "FORM with its derivatives by TIME of variables as symbols that LaTeX writes with dots; other parts in the same
order."
  (labels ((walk (form)
             (cond ((atom form) form)
                   ((time-derivative-p form) (dotted-symbol (second form) (fourth form)))
                   (t (let ((parts (mapcar #'walk (rest form))))
                        (if (every #'eq parts (rest form)) form (cons (first form) parts))))))
           (time-derivative-p (form)
             (and (operator-p form 'maxima::%derivative)
                  (or (symbolp (second form)) (member 'maxima::array (first (second form))))
                  (eq (third form) time) (null (nthcdr 4 form))
                  (typep (fourth form) '(integer 1 4))))
           (dotted-symbol (variable order)
             (let ((symbol (make-symbol "DOTTED")))
               (setf (get symbol 'maxima::texword) (dotted-name variable order))
               symbol)))
    (walk form)))

(maxima::defmfun maxima::$anmech_dotted (form time)
  "anmech_dotted(expr, time): for tex1, with dots for derivatives by time."
  (dotted form time))
